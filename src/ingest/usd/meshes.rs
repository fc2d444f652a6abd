//! The meshes of a stage to world-space triangles.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DAffine3, DVec3};
use openusd::usd::Prim;

use super::instancer::{Instances, instances};
use super::light::{self, Found};
use super::material::Materials;
use super::mesh::Mesh;
use super::walk::Below;
use super::{OpenedStage, with_stage};
use crate::error::{Error, Result};
use crate::ingest::geometry::{DroppedTriangles, bounds};
use crate::ingest::gltf::MeshReport;
use crate::ingest::requests::Contents;
use crate::ingest::tangents;
use crate::job::MeshInput;
use crate::scene::{Light, Meshes};

/// So many times may a file place its meshes by instancers, or once for each of its bytes: instancers of instancers multiply
/// what a small file holds.
const MIN_PLACED: usize = 1 << 20;

/// Deepest nesting of instancers in prototypes.
const MAX_INSTANCERS: usize = 32;

/// Types of prims that have a surface, but not as a mesh.
const OTHER_SURFACES: [&str; 10] =
    ["Sphere", "Cube", "Cylinder", "Cylinder_1", "Cone", "Capsule", "Capsule_1", "Plane", "NurbsPatch", "TetMesh"];

/// Types of prims that are drawn without a surface.
const LINES_AND_POINTS: [&str; 4] = ["BasisCurves", "NurbsCurves", "HermiteCurves", "Points"];

/// What the stage at `path` holds.
pub fn contents(path: &Path) -> Result<Contents> {
    with_stage(path, |stage| {
        let mut contents = Contents::default();
        stage.walk(|prim, _| {
            match stage.kind(prim)?.as_str() {
                "ParticleField3DGaussianSplat" => contents.splats = true,
                "Mesh" | "PointInstancer" | "DistantLight" | "SphereLight" => contents.meshes = true,
                _ => {}
            }
            Ok(Below::Visit)
        })?;
        Ok(contents)
    })
}

/// Appends the triangles of the stage of `input`, with their materials and textures, to `meshes`, and its lights to `lights`.
///
/// Transforms are composed in f64; positions are stored relative to `origin` (world, metres). Values that change over time
/// are read at their first sample. On an error `meshes` and `lights` may hold a part of the file.
///
/// # Errors
/// [`Error::Request`] when the input names a scene, which USD has none of; [`Error::Invalid`] when the stage cannot be
/// composed or an attribute does not fit; [`Error::Unsupported`] for what is too large.
pub fn load(input: &MeshInput, origin: DVec3, meshes: &mut Meshes, lights: &mut Vec<Light>) -> Result<MeshReport> {
    for (field, given) in [("scene", &input.scene), ("variant", &input.variant)] {
        if given.is_some() {
            let why =
                format!("{} is USD, which has no such thing as glTF's {field}s: leave it out", input.path.display());
            return Err(Error::request(field, why));
        }
    }
    with_stage(&input.path, |stage| {
        let canonical_from_file = DAffine3::from_mat3(stage.frame.canonical_from_file());
        let world_from_file = input.transform.world_from_file() * canonical_from_file;
        let (first_vertex, first_triangle, first_light) =
            (meshes.positions.len(), meshes.triangles.len(), lights.len());
        let bytes = std::fs::metadata(stage.path).map_err(|source| Error::read(stage.path, source))?.len();
        let stored_from_file = [DAffine3::from_translation(-origin) * world_from_file];
        let mut loader = Loader {
            stage,
            stage_unit: light::mean_scale(world_from_file) * stage.metres_per_unit,
            most_placed: usize::try_from(bytes).unwrap_or(usize::MAX).max(MIN_PLACED),
            placed: 0,
            instancers: Vec::new(),
            materials: Materials::new(input.missing_texture),
            dropped: DroppedTriangles::default(),
            prims: 0,
            skipped_primitives: 0,
            dark_lights: 0,
            notes: Notes::default(),
            meshes,
            lights,
        };
        stage.walk(|prim, file_from_prim| loader.append(prim, file_from_prim, &stored_from_file))?;
        stage.check_composition()?;
        let Loader { materials, dropped, prims, skipped_primitives, dark_lights, notes, .. } = loader;
        Ok(MeshReport {
            path: input.path.clone(),
            files: [vec![input.path.clone()], stage.resolver.log.files()].concat(),
            scene: None,
            nodes: prims,
            dropped_triangles: dropped,
            skipped_primitives,
            materials: materials.materials_in_use(),
            variants: Vec::new(),
            textures: materials.textures_in_use(),
            replaced_images: materials.into_replaced_images(),
            lights: lights.len() - first_light,
            dark_lights,
            extensions_used: Vec::new(),
            extensions_ignored: Vec::new(),
            notes: notes.lines(),
            triangles: meshes.triangles.len() - first_triangle,
            bounds: bounds(meshes, first_vertex, origin),
        })
    })
}

/// One pass over the prims of a stage.
struct Loader<'a> {
    stage: &'a OpenedStage<'a>,
    /// A unit of the stage in metres in the world.
    stage_unit: f64,
    most_placed: usize,
    placed: usize,
    /// Those whose prototypes are being read.
    instancers: Vec<String>,
    materials: Materials,
    dropped: DroppedTriangles,
    prims: usize,
    skipped_primitives: usize,
    dark_lights: usize,
    notes: Notes,
    meshes: &'a mut Meshes,
    lights: &'a mut Vec<Light>,
}

impl Loader<'_> {
    /// Appends what `prim` draws, once for each of the places that `stored_from_root` gives the root of the walk.
    fn append(&mut self, prim: &Prim, root_from_prim: &DAffine3, stored_from_root: &[DAffine3]) -> Result<Below> {
        self.prims += 1;
        let kind = self.stage.kind(prim)?;
        match kind.as_str() {
            "Mesh" => self.append_mesh(prim, root_from_prim, stored_from_root)?,
            "PointInstancer" => {
                self.append_instances(prim, root_from_prim, stored_from_root)?;
                // Prototypes below an instancer are drawn by it alone.
                return Ok(Below::Skip);
            }
            "SkelRoot" => self.notes.add("skinned meshes are read as their points stand, without their skeleton", prim),
            kind if LINES_AND_POINTS.contains(&kind) => self.skipped_primitives += 1,
            kind if OTHER_SURFACES.contains(&kind) => {
                self.notes.add(&format!("{kind} prims are left out: make them Mesh prims"), prim);
            }
            kind => self.append_lights(prim, kind, root_from_prim, stored_from_root)?,
        }
        Ok(Below::Visit)
    }

    fn append_lights(
        &mut self,
        prim: &Prim,
        kind: &str,
        root_from_prim: &DAffine3,
        stored_from_root: &[DAffine3],
    ) -> Result<()> {
        for &stored in stored_from_root {
            let found =
                light::read(self.stage, prim, kind, stored * *root_from_prim, self.stage_unit, &mut self.notes)?;
            match found {
                Found::NoLight => break,
                Found::Dark => self.dark_lights += 1,
                Found::Light(light) => self.lights.push(light),
            }
        }
        Ok(())
    }

    fn append_mesh(&mut self, prim: &Prim, root_from_prim: &DAffine3, stored_from_root: &[DAffine3]) -> Result<()> {
        let Some(mesh) = Mesh::read(self.stage, prim)? else { return Ok(()) };
        if mesh.is_cage {
            self.notes.add("subdivision meshes are read as their cages", prim);
        }
        self.place(prim, stored_from_root.len())?;
        let placements: Vec<DAffine3> = stored_from_root.iter().map(|&stored| stored * *root_from_prim).collect();
        for group in mesh.face_groups(self.stage, prim)? {
            let (material, primvars) =
                self.materials.surface(self.stage, prim, &mesh, &group.prim, &mut self.notes, self.meshes)?;
            let mut geometry = mesh.geometry(self.stage, prim, &group.faces, &primvars)?;
            if let Some(uv_set) = self.meshes.materials[material as usize].tangent_uv_set() {
                tangents::generate(&mut geometry, uv_set);
            }
            geometry.append(self.stage.path, &placements, material, self.meshes, &mut self.dropped)?;
        }
        Ok(())
    }

    fn append_instances(
        &mut self,
        prim: &Prim,
        root_from_prim: &DAffine3,
        stored_from_root: &[DAffine3],
    ) -> Result<()> {
        let path = prim.path().as_str().to_owned();
        if self.instancers.contains(&path) {
            return Err(self.stage.invalid(prim, "the instancer is, by its prototypes, part of itself"));
        }
        if self.instancers.len() == MAX_INSTANCERS {
            let what = format!("{path}: instancers inside of prototypes, more than {MAX_INSTANCERS} deep");
            return Err(Error::unsupported(self.stage.path, what));
        }
        self.instancers.push(path);
        for Instances { prototype, instancer_from_instances } in instances(self.stage, prim)? {
            self.place(prim, stored_from_root.len().saturating_mul(instancer_from_instances.len()))?;
            let stored_from_instances: Vec<DAffine3> = stored_from_root
                .iter()
                .flat_map(|&stored| instancer_from_instances.iter().map(move |&place| stored * *root_from_prim * place))
                .collect();
            let prototype = self.stage.stage.prim(prototype);
            if !self.stage.ask(&prototype, prototype.is_valid())? {
                return Err(self.stage.invalid(prim, format!("its prototype {} is not there", prototype.path())));
            }
            let stage = self.stage;
            stage.walk_prototype(prototype, &mut |prim, root_from_prim| {
                self.append(prim, root_from_prim, &stored_from_instances)
            })?;
        }
        self.instancers.pop();
        Ok(())
    }

    /// Counts `count` places more, from `prim` on.
    fn place(&mut self, prim: &Prim, count: usize) -> Result<()> {
        self.placed = self.placed.saturating_add(count);
        if self.placed > self.most_placed {
            let most = self.most_placed;
            let what = format!("meshes placed more than {most} times from {} on; place fewer", prim.path());
            return Err(Error::unsupported(self.stage.path, what));
        }
        Ok(())
    }
}

/// What is read in another way than the file means, or left out: each with the first prim that it concerns.
#[derive(Default)]
pub struct Notes(BTreeMap<String, (String, usize)>);

impl Notes {
    pub fn add(&mut self, what: &str, prim: &Prim) {
        self.add_at(what, prim.path().as_str());
    }

    pub fn add_at(&mut self, what: &str, place: &str) {
        match self.0.get_mut(what) {
            Some((_, others)) => *others += 1,
            None => drop(self.0.insert(what.to_owned(), (place.to_owned(), 0))),
        }
    }

    fn lines(self) -> Vec<String> {
        let line = |(what, (first, others)): (String, (String, usize))| match others {
            0 => format!("{what}: {first}"),
            _ => format!("{what}: {first} and {others} more"),
        };
        self.0.into_iter().map(line).collect()
    }
}
