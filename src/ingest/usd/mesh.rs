//! Mesh prims: faces of any number of corners, and what their corners carry (UsdGeomMesh).

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use openusd::sdf::Value;
use openusd::usd::Prim;

use super::OpenedStage;
use super::polygon::{self, MAX_CONCAVE_CORNERS};
use super::primvar::{Corner, Interpolation, Primvar};
use crate::ingest::geometry::Geometry;
use crate::{Error, Result};

/// The faces of a mesh, by the numbers of their points.
pub struct Topology {
    /// How many points there are.
    pub points: usize,
    /// Corners of each face.
    pub counts: Vec<usize>,
    /// The points of the corners of all faces, face by face.
    pub corners: Vec<usize>,
}

/// A mesh as its prim describes it.
pub struct Mesh {
    positions: Vec<DVec3>,
    pub topology: Topology,
    /// Faces that are left out.
    is_hole: Vec<bool>,
    /// Whether corners run clockwise, seen from the front.
    left_handed: bool,
    pub double_sided: bool,
    /// Whether the mesh is the cage of a smooth surface.
    pub is_cage: bool,
    normals: Option<Primvar<3>>,
}

/// Which primvars a surface reads.
#[derive(Default)]
pub struct SurfacePrimvars {
    /// Texture coordinates, v up.
    pub uv: [Option<Primvar<2>>; 2],
    pub colour: Option<Primvar<3>>,
    pub opacity: Option<Primvar<1>>,
}

/// Faces that share a material.
pub struct FaceGroup {
    /// The prim whose binding counts: the mesh, or one of its subsets.
    pub prim: Prim,
    pub faces: Vec<usize>,
}

impl Mesh {
    /// Reads `prim`; `None` when it has no faces.
    pub fn read(stage: &OpenedStage, prim: &Prim) -> Result<Option<Self>> {
        let points = stage.vectors::<3>(prim, "points")?.unwrap_or_default();
        let positions: Vec<DVec3> = points.into_iter().map(|point| Vec3::from(point).as_dvec3()).collect();
        let topology = Topology::read(stage, prim, positions.len())?;
        if topology.counts.is_empty() {
            return Ok(None);
        }
        let mut is_hole = vec![false; topology.counts.len()];
        for face in stage.integers(prim, "holeIndices")? {
            let hole = usize::try_from(face).ok().and_then(|face| is_hole.get_mut(face));
            let out =
                || stage.invalid(prim, format!("holeIndices has {face}; there are {} faces", topology.counts.len()));
            *hole.ok_or_else(out)? = true;
        }
        let left_handed = match stage.token(prim, "orientation")?.as_deref() {
            None | Some("rightHanded") => false,
            Some("leftHanded") => true,
            Some(other) => return Err(stage.invalid(prim, format!("orientation {other} is none that USD knows"))),
        };
        let double_sided = matches!(stage.value(prim, "doubleSided")?, Some(Value::Bool(true)));
        let scheme = stage.token(prim, "subdivisionScheme")?;
        let is_cage = scheme.as_deref() != Some("none");
        let normals = match Primvar::read(stage, prim, "primvars:normals", Interpolation::Constant, &topology)? {
            Some(normals) => Some(normals),
            None => Primvar::read(stage, prim, "normals", Interpolation::Vertex, &topology)?,
        };
        let mut mesh = Self { positions, topology, is_hole, left_handed, double_sided, is_cage, normals };
        // What is subdivided becomes smooth; bilinear faces keep their edges.
        if mesh.normals.is_none() && is_cage && scheme.as_deref() != Some("bilinear") {
            mesh.normals = Some(mesh.smooth_normals());
        }
        Ok(Some(mesh))
    }

    /// The faces by what their material is bound to: those of each material subset, then the rest under the mesh itself.
    pub fn face_groups(&self, stage: &OpenedStage, prim: &Prim) -> Result<Vec<FaceGroup>> {
        let mut is_taken = self.is_hole.clone();
        let mut groups = Vec::new();
        for child in stage.ask(prim, prim.children())? {
            if stage.ask(&child, child.type_name())?.is_none_or(|kind| kind != "GeomSubset")
                || stage.token(&child, "familyName")?.as_deref() != Some("materialBind")
                || stage.token(&child, "elementType")?.is_some_and(|kind| kind != "face")
            {
                continue;
            }
            let mut faces = Vec::new();
            for index in stage.integers(&child, "indices")? {
                let face = usize::try_from(index).ok().filter(|&face| face < is_taken.len());
                let out = || stage.invalid(&child, format!("indices has {index}; there are {} faces", is_taken.len()));
                let face = face.ok_or_else(out)?;
                if !std::mem::replace(&mut is_taken[face], true) {
                    faces.push(face);
                }
            }
            groups.push(FaceGroup { prim: child, faces });
        }
        let rest = (0..is_taken.len()).filter(|&face| !is_taken[face]).collect();
        groups.push(FaceGroup { prim: prim.clone(), faces: rest });
        groups.retain(|group| !group.faces.is_empty());
        Ok(groups)
    }

    /// The triangles of `faces`, in ascending order of the corners' places, with what `primvars` gives their corners.
    /// Corners that are alike share a vertex.
    pub fn geometry(
        &self,
        stage: &OpenedStage,
        prim: &Prim,
        faces: &[usize],
        primvars: &SurfacePrimvars,
    ) -> Result<Geometry> {
        let firsts = self.topology.first_corners();
        let mut builder =
            GeometryBuilder { mesh: self, primvars, vertices: HashMap::new(), geometry: Geometry::default() };
        for &face in faces {
            let first = firsts[face];
            let points = &self.topology.corners[first..first + self.topology.counts[face]];
            let corners: Vec<DVec3> = points.iter().map(|&point| self.positions[point]).collect();
            let triangles = polygon::triangulate(&corners).map_err(|_| {
                let what = format!(
                    "{}: face {face} has {} corners and is not convex; at most {MAX_CONCAVE_CORNERS} are read: cut it up",
                    prim.path(),
                    corners.len()
                );
                Error::unsupported(stage.path, what)
            })?;
            for [a, b, c] in triangles {
                let places = if self.left_handed { [a, c, b] } else { [a, b, c] };
                let triangle = places.map(|i| builder.vertex(Corner { face, point: points[i], corner: first + i }));
                builder.geometry.triangles.push(triangle);
            }
        }
        Ok(builder.geometry)
    }

    /// Normals at the points: those of the faces around, weighted by area.
    fn smooth_normals(&self) -> Primvar<3> {
        let mut sums = vec![DVec3::ZERO; self.positions.len()];
        let mut first = 0;
        for &count in &self.topology.counts {
            let points = &self.topology.corners[first..first + count];
            first += count;
            // From a corner of the face, so that what is far from the origin keeps its digits.
            let corner = |&point: &usize| self.positions[point] - self.positions[points[0]];
            let around = points.iter().zip(points.iter().cycle().skip(1));
            let area: DVec3 = around.map(|(a, b)| corner(a).cross(corner(b))).sum();
            points.iter().for_each(|&point| sums[point] += area);
        }
        let facing = if self.left_handed { -1.0 } else { 1.0 };
        let values = sums.into_iter().map(|sum| (sum * facing).normalize_or_zero().as_vec3().to_array()).collect();
        Primvar { interpolation: Interpolation::Vertex, values, indices: None }
    }
}

impl Topology {
    fn read(stage: &OpenedStage, prim: &Prim, points: usize) -> Result<Self> {
        let mut total = 0usize;
        let counts = stage.integers(prim, "faceVertexCounts")?.into_iter().map(|count| {
            let count = usize::try_from(count);
            let count = count.map_err(|_| stage.invalid(prim, "faceVertexCounts has a negative number"))?;
            total = total.saturating_add(count);
            Ok(count)
        });
        let counts: Vec<usize> = counts.collect::<Result<_>>()?;
        let indices = stage.integers(prim, "faceVertexIndices")?;
        if indices.len() != total {
            let what = format!("faceVertexCounts asks for {total} corners and faceVertexIndices has {}", indices.len());
            return Err(stage.invalid(prim, what));
        }
        let corners = indices.into_iter().map(|index| {
            let point = usize::try_from(index).ok().filter(|&point| point < points);
            let out = || stage.invalid(prim, format!("faceVertexIndices has {index}; there are {points} points"));
            point.ok_or_else(out)
        });
        Ok(Self { points, counts, corners: corners.collect::<Result<_>>()? })
    }

    /// The place of each face's first corner among all corners.
    fn first_corners(&self) -> Vec<usize> {
        let starts = self.counts.iter().scan(0, |next, count| {
            let first = *next;
            *next += count;
            Some(first)
        });
        starts.collect()
    }
}

/// What a vertex is, to the bit: its point, normal, texture coordinates and colour.
type VertexKey = (usize, [u32; 3], [[u32; 2]; 2], [u32; 4]);

struct GeometryBuilder<'a> {
    mesh: &'a Mesh,
    primvars: &'a SurfacePrimvars,
    /// Only looked up, never listed.
    vertices: HashMap<VertexKey, u32>,
    geometry: Geometry,
}

impl GeometryBuilder<'_> {
    fn vertex(&mut self, corner: Corner) -> u32 {
        let normal = self.mesh.normals.as_ref().map_or([0.0; 3], |normals| normals.at(corner));
        // The scene's v points down, as images are stored.
        let uv = self.primvars.uv.each_ref().map(|set| {
            set.as_ref().map_or([0.0; 2], |set| {
                let [u, v] = set.at(corner);
                [u, 1.0 - v]
            })
        });
        let [r, g, b] = self.primvars.colour.as_ref().map_or([1.0; 3], |colour| colour.at(corner));
        let [opacity] = self.primvars.opacity.as_ref().map_or([1.0], |opacity| opacity.at(corner));
        let colour = [r, g, b, opacity];
        let key = (corner.point, normal.map(f32::to_bits), uv.map(|uv| uv.map(f32::to_bits)), colour.map(f32::to_bits));
        let geometry = &mut self.geometry;
        *self.vertices.entry(key).or_insert_with(|| {
            geometry.positions.push(self.mesh.positions[corner.point]);
            geometry.normals.push(Vec3::from(normal).as_dvec3());
            for (stored, (set, uv)) in geometry.uv.iter_mut().zip(self.primvars.uv.iter().zip(uv)) {
                if set.is_some() {
                    stored.push(uv);
                }
            }
            if self.primvars.colour.is_some() || self.primvars.opacity.is_some() {
                geometry.colours.push(colour);
            }
            // Corners are counted by the file's bytes, far below 2^32 of them; what passes that many is refused on appending.
            geometry.positions.len() as u32 - 1
        })
    }
}
