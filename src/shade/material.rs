//! What a material says where a ray meets it. The one place that evaluates base colour, emission, alpha and all others.

use std::cell::Cell;

use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

use super::bsdf::Parameters;
use super::texture::{UvArea, sample};
use crate::scene::material::{AlphaMode, Anisotropy, ColourMap, NormalMap, ScalarMap, TextureRef};
use crate::scene::{LinearRgb, Material, Meshes};
use crate::trace::{Ray, SurfaceHit};

/// A surface where a ray meets it. Nothing is looked up before it is asked for.
///
/// All normals point to the side that the ray came from.
#[derive(Debug)]
pub struct SurfacePoint<'a> {
    meshes: &'a Meshes,
    /// The material.
    pub material: &'a Material,
    /// Whether the ray came from the front, the side from which the corners run counter-clockwise.
    pub front: bool,
    /// Unit normal of the triangle.
    pub geometric_normal: Vec3,
    corners: [usize; 3],
    weights: [f32; 3],
    /// The ellipse that the ray cuts out of the triangle's plane, as conjugate diameters in barycentric weights of the
    /// second and third corner.
    area: [Vec2; 2],
    /// The last look-up: materials often read several channels of one texture.
    last: Cell<Option<(TextureRef, Vec4)>>,
}

/// All that a material says at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaterialPoint {
    /// Share of the light behind the surface that it holds back: 0 for nothing there, 1 for opaque.
    pub coverage: f32,
    /// Emitted radiance; nothing for unlit materials.
    pub emission: LinearRgb,
    /// Share of indirect light that arrives, as the file says.
    pub occlusion: f32,
    /// Base colour is the radiance, and nothing else counts.
    pub unlit: bool,
    /// Whether the ray came from the front.
    pub front: bool,
    /// Unit normal of the triangle.
    pub geometric_normal: Vec3,
    /// Unit normal of the smooth surface with its normal map.
    pub normal: Vec3,
    /// Unit normal of the clearcoat.
    pub clearcoat_normal: Vec3,
    /// Unit vector across `normal`, along the first texture coordinate where the material needs it.
    pub tangent: Vec3,
    /// Unit vector across both, against the second texture coordinate. The three may be left-handed.
    pub bitangent: Vec3,
    /// What the light that is scattered depends on.
    pub parameters: Parameters,
}

impl<'a> SurfacePoint<'a> {
    /// The point of `meshes` at `hit`, seen by a `ray` that is `width` metres wide there: textures are averaged over it.
    ///
    /// A ray of that width is a cylinder near the hit, which the triangle's plane cuts in an ellipse (Akenine-Moeller et
    /// al. 2021, "Improved Shader and Texture Level of Detail Using Ray Cones").
    pub fn new(meshes: &'a Meshes, ray: &Ray, hit: &SurfaceHit, width: f32) -> Self {
        let triangle = hit.triangle as usize;
        let [a, b, c] = meshes.corners(triangle);
        let (to_b, to_c) = (b - a, c - a);
        let across = to_b.cross(to_c);
        let normal = across.normalize_or_zero();
        let direction = ray.direction.as_vec3();
        let area = if width > 0.0 {
            // The longer axis lies along the ray's projection, the shorter one across it.
            let cosine = normal.dot(direction).abs();
            let sideways = normal.cross(direction).try_normalize().unwrap_or_else(|| normal.any_orthonormal_vector());
            let onward = normal.cross(sideways) * (width / cosine.max(MIN_COSINE));
            let inverse = across.length_squared().recip();
            let weights = |v: Vec3| Vec2::new(v.cross(to_c).dot(across), to_b.cross(v).dot(across)) * inverse;
            [weights(onward), weights(sideways * width)]
        } else {
            [Vec2::ZERO; 2]
        };
        let (second, third) = (hit.barycentric.x, hit.barycentric.y);
        Self {
            meshes,
            material: meshes.material_of(triangle),
            front: hit.front,
            geometric_normal: if hit.front { normal } else { -normal },
            corners: meshes.triangles[triangle].map(|v| v as usize),
            weights: [1.0 - second - third, second, third],
            area,
            last: Cell::new(None),
        }
    }

    /// Linear base colour, and what is made of its alpha (glTF 2.0, section 3.9.4).
    pub fn base_colour_and_coverage(&self) -> (Vec3, f32) {
        let corner = |k: usize| self.meshes.attributes[self.corners[k]].colour * self.weights[k];
        let material = self.material;
        let texture = material.base_colour_texture.map_or(Vec4::ONE, |texture| self.texture(&texture));
        let base = material.base_colour * (corner(0) + corner(1) + corner(2)) * texture;
        let coverage = match material.alpha {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask { cutoff } => f32::from(u8::from(base.w >= cutoff)),
            AlphaMode::Blend => base.w.clamp(0.0, 1.0),
        };
        (base.xyz(), coverage)
    }

    /// Emitted radiance; nothing for unlit materials.
    pub fn emission(&self) -> LinearRgb {
        let material = self.material;
        if material.unlit || material.emissive.0 == Vec3::ZERO {
            return LinearRgb::default();
        }
        let texture = material.emissive_texture.map_or(Vec3::ONE, |texture| self.texture(&texture).xyz());
        LinearRgb(material.emissive.0 * texture)
    }

    /// All that the material says.
    pub fn evaluate(&self) -> MaterialPoint {
        let material = self.material;
        let (base_colour, coverage) = self.base_colour_and_coverage();
        let basis = self.basis();
        let normal = self.mapped(&material.normal, &basis);
        let (tangent, bitangent) = basis.across(normal);
        let (anisotropy_strength, anisotropy_rotation) = self.anisotropy(&material.anisotropy);
        MaterialPoint {
            coverage,
            emission: self.emission(),
            occlusion: self.unit(&material.occlusion),
            unlit: material.unlit,
            front: self.front,
            geometric_normal: self.geometric_normal,
            normal,
            clearcoat_normal: self.mapped(&material.clearcoat.normal, &basis),
            tangent,
            bitangent,
            parameters: Parameters {
                base_colour,
                metallic: self.unit(&material.metallic),
                roughness: self.unit(&material.roughness),
                ior: material.ior,
                specular: self.unit(&material.specular),
                specular_colour: self.colour(&material.specular_colour),
                clearcoat: self.unit(&material.clearcoat.factor),
                clearcoat_roughness: self.unit(&material.clearcoat.roughness),
                sheen_colour: self.colour(&material.sheen.colour),
                sheen_roughness: self.unit(&material.sheen.roughness),
                transmission: self.unit(&material.transmission),
                thickness: self.scalar(&material.volume.thickness).max(0.0),
                attenuation_colour: material.volume.attenuation_colour.0,
                attenuation_distance: material.volume.attenuation_distance,
                anisotropy_strength,
                anisotropy_rotation,
                iridescence: self.unit(&material.iridescence.factor),
                iridescence_ior: material.iridescence.ior,
                iridescence_thickness_nm: self.scalar(&material.iridescence.thickness_nm).max(0.0),
                dispersion: material.dispersion,
            },
        }
    }

    fn texture(&self, texture: &TextureRef) -> Vec4 {
        if let Some((last, value)) = self.last.get()
            && last == *texture
        {
            return value;
        }
        let [a, b, c] = self.corners.map(|v| self.meshes.attributes[v].uv[usize::from(texture.uv_set)]);
        let uv = a * self.weights[0] + b * self.weights[1] + c * self.weights[2];
        let [along, across] =
            self.area.map(|weights| texture.uv_from_uv.transform_vector2((b - a) * weights.x + (c - a) * weights.y));
        let uv = texture.uv_from_uv.transform_point2(uv);
        let value = sample(&self.meshes.textures[texture.texture as usize], uv, UvArea { along, across });
        self.last.set(Some((*texture, value)));
        value
    }

    fn scalar(&self, map: &ScalarMap) -> f32 {
        let channel = map.texture.map_or(1.0, |(texture, channel)| self.texture(&texture)[channel as usize]);
        map.offset + map.factor * channel
    }

    fn unit(&self, map: &ScalarMap) -> f32 {
        self.scalar(map).clamp(0.0, 1.0)
    }

    fn colour(&self, map: &ColourMap) -> Vec3 {
        map.factor * map.texture.map_or(Vec3::ONE, |texture| self.texture(&texture).xyz())
    }

    /// Strength, and angle from the tangent toward the bitangent.
    fn anisotropy(&self, anisotropy: &Anisotropy) -> (f32, f32) {
        let Some(texture) = anisotropy.texture else { return (anisotropy.strength.min(1.0), anisotropy.rotation) };
        let texel = self.texture(&texture);
        let direction = texel.xy() * 2.0 - 1.0;
        ((anisotropy.strength * texel.z).min(1.0), anisotropy.rotation + direction.y.atan2(direction.x))
    }

    /// The smooth surface's own directions, on the ray's side.
    fn basis(&self) -> Basis {
        let sum = |corner: &dyn Fn(usize) -> Vec4| {
            corner(self.corners[0]) * self.weights[0]
                + corner(self.corners[1]) * self.weights[1]
                + corner(self.corners[2]) * self.weights[2]
        };
        let outward = if self.front { self.geometric_normal } else { -self.geometric_normal };
        let interpolated = sum(&|v| self.meshes.attributes[v].normal.extend(0.0)).xyz();
        let normal = if interpolated.length_squared() > MIN_LENGTH_SQUARED { interpolated } else { outward };
        let tangent = if self.meshes.tangents.is_empty() { Vec4::ZERO } else { sum(&|v| self.meshes.tangent_of(v)) };
        let sign = if tangent.w < 0.0 { -1.0 } else { 1.0 };
        let bitangent = normal.cross(tangent.xyz()) * sign;
        // Normals of an inside-out mesh point into it, and those of a back away from the ray.
        let facing = if (normal.dot(outward) < 0.0) == self.front { -1.0 } else { 1.0 };
        Basis { normal: normal * facing, tangent: tangent.xyz(), bitangent, facing }
    }

    /// The unit normal of a normal map, or the smooth surface's own (glTF 2.0, section 3.9.3).
    ///
    /// Directions are used as they are interpolated, not of unit length, which MikkTSpace demands of its readers.
    fn mapped(&self, map: &Option<NormalMap>, basis: &Basis) -> Vec3 {
        let smooth = basis.normal.normalize();
        let Some(map) = map.filter(|_| basis.tangent != Vec3::ZERO) else { return smooth };
        let texel = self.texture(&map.texture).xyz() * 2.0 - 1.0;
        let (x, y) = (texel.x * map.scale, texel.y * map.scale);
        let tilted = (basis.tangent * x + basis.bitangent * y) * basis.facing + basis.normal * texel.z;
        if tilted.length_squared() > MIN_LENGTH_SQUARED { tilted.normalize() } else { smooth }
    }
}

/// A ray this close to the plane (0.06 degrees) cuts as long an ellipse as any: beyond it f32 has no more to say.
const MIN_COSINE: f32 = 1e-3;

/// Directions shorter than 1e-6 are rounding.
const MIN_LENGTH_SQUARED: f32 = 1e-12;

/// Directions of the smooth surface, as interpolated: neither of unit length nor at right angles.
struct Basis {
    /// On the ray's side.
    normal: Vec3,
    /// Zero where the material needs none or the file gives none.
    tangent: Vec3,
    bitangent: Vec3,
    /// -1 where `normal` was turned round to the ray's side. The surface's relief turns with it.
    facing: f32,
}

impl Basis {
    /// Unit vectors at right angles to the unit `normal` and each other, near tangent and bitangent.
    fn across(&self, normal: Vec3) -> (Vec3, Vec3) {
        let along = self.tangent - normal * normal.dot(self.tangent);
        if along.length_squared() <= MIN_LENGTH_SQUARED {
            return normal.any_orthonormal_pair();
        }
        let tangent = along.normalize();
        let bitangent = normal.cross(tangent);
        (tangent, if bitangent.dot(self.bitangent) < 0.0 { -bitangent } else { bitangent })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DVec3, Mat3};

    use super::*;
    use crate::scene::material::Channel;
    use crate::scene::mesh::VertexAttributes;
    use crate::scene::texture::{Encoding, Filter, Image, Texture, Wrap};

    /// The triangle (0, 0), (1, 0), (0, 1) that faces +z, with u along x and v against y, tangents, and one texture.
    fn meshes(material: Material, encoding: Encoding, size: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Meshes {
        let texels: Vec<[u8; 4]> = (0..size * size).map(|i| texel(i % size, i / size)).collect();
        let image = Arc::new(Image::new(size, size, encoding, || Ok(texels)));
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y];
        let attributes = positions.iter().map(|p| VertexAttributes {
            normal: Vec3::Z,
            uv: [Vec2::new(p.x, 1.0 - p.y); 2],
            ..VertexAttributes::default()
        });
        Meshes {
            attributes: attributes.collect(),
            positions,
            tangents: vec![Vec4::new(1.0, 0.0, 0.0, 1.0); 3],
            triangles: vec![[0, 1, 2]],
            triangle_materials: vec![0],
            materials: vec![material],
            textures: vec![Texture { image, wrap: [Wrap::Repeat; 2], filter: Filter::default() }],
            ..Meshes::default()
        }
    }

    const TEXTURE: TextureRef = TextureRef { texture: 0, uv_set: 0, uv_from_uv: Mat3::IDENTITY };

    fn ray(direction: DVec3) -> Ray {
        Ray { origin: -direction, direction: direction.normalize() }
    }

    fn point_of<'a>(meshes: &'a Meshes, ray: &Ray, width: f32) -> SurfacePoint<'a> {
        let front = ray.direction.z < 0.0;
        let hit = SurfaceHit { triangle: 0, barycentric: Vec2::splat(0.25), front, distance: 1.0 };
        SurfacePoint::new(meshes, ray, &hit, width)
    }

    fn seen(meshes: &Meshes, direction: DVec3) -> MaterialPoint {
        point_of(meshes, &ray(direction), 0.0).evaluate()
    }

    fn is_orthonormal(point: &MaterialPoint) -> bool {
        let [n, t, b] = [point.normal, point.tangent, point.bitangent];
        [n, t, b].iter().all(|v| (v.length() - 1.0).abs() < 1e-5)
            && [n.dot(t), n.dot(b), t.dot(b)].iter().all(|cosine| cosine.abs() < 1e-5)
    }

    #[test]
    fn a_plain_material_gives_gltfs_defaults_and_the_surfaces_own_directions() {
        let meshes = meshes(Material::default(), Encoding::Linear, 1, |_, _| [0; 4]);
        for (direction, normal) in [(DVec3::NEG_Z, Vec3::Z), (DVec3::Z, Vec3::NEG_Z)] {
            let point = seen(&meshes, direction);
            assert_eq!(point.parameters, Parameters::default());
            assert_eq!((point.coverage, point.occlusion, point.emission), (1.0, 1.0, LinearRgb(Vec3::ZERO)));
            assert_eq!([point.normal, point.clearcoat_normal, point.geometric_normal], [normal; 3]);
            assert_eq!(point.front, normal == Vec3::Z);
            assert!(is_orthonormal(&point));
        }
        assert!(!meshes.textures[0].image.is_decoded(), "nothing asked for the texture");
    }

    #[test]
    fn normal_maps_tilt_toward_tangent_and_bitangent_and_turn_round_with_the_back() {
        // (1, 0.5, 0.5) stored: x = 1, y = 0, z = 0 but for rounding, 1/255 each.
        let tilted = |texel: [u8; 4], scale: f32, direction: DVec3| {
            let normal = Some(NormalMap { texture: TEXTURE, scale });
            seen(&meshes(Material { normal, ..Material::default() }, Encoding::Linear, 1, |_, _| texel), direction)
        };
        let diagonal = tilted([255, 128, 255, 255], 1.0, DVec3::NEG_Z);
        assert!(diagonal.normal.abs_diff_eq(Vec3::new(1.0, 0.0, 1.0).normalize(), 0.005), "{}", diagonal.normal);
        assert!(is_orthonormal(&diagonal) && diagonal.tangent.x > 0.0 && diagonal.bitangent.y > 0.99);
        assert_eq!(diagonal.clearcoat_normal, Vec3::Z, "a coat without normals follows the geometry");
        let up = tilted([128, 255, 255, 255], 1.0, DVec3::NEG_Z).normal;
        assert!(up.abs_diff_eq(Vec3::new(0.0, 1.0, 1.0).normalize(), 0.005), "green is up in the image: {up}");
        let flatter = tilted([255, 128, 255, 255], 0.5, DVec3::NEG_Z).normal;
        assert!(flatter.abs_diff_eq(Vec3::new(0.5, 0.0, 1.0).normalize(), 0.005), "{flatter}");
        let back = tilted([255, 128, 255, 255], 1.0, DVec3::Z);
        assert!(back.normal.abs_diff_eq(-diagonal.normal, 1e-6), "{}", back.normal);
        let nothing = tilted([127, 127, 127, 255], 0.0, DVec3::NEG_Z).normal;
        assert!(nothing.is_normalized(), "{nothing}");
    }

    #[test]
    fn normals_of_an_inside_out_mesh_point_to_the_ray_all_the_same() {
        let mut meshes = meshes(Material::default(), Encoding::Linear, 1, |_, _| [0; 4]);
        meshes.attributes.iter_mut().for_each(|vertex| vertex.normal = Vec3::NEG_Z);
        assert_eq!(seen(&meshes, DVec3::NEG_Z).normal, Vec3::Z);
        meshes.attributes.iter_mut().for_each(|vertex| vertex.normal = Vec3::ZERO);
        assert_eq!(seen(&meshes, DVec3::Z).normal, Vec3::NEG_Z, "without normals the triangle's own serves");
    }

    #[test]
    fn maps_take_their_channel_and_stay_in_range() {
        let map = |offset, factor, channel| ScalarMap { offset, factor, texture: Some((TEXTURE, channel)) };
        let material = Material {
            metallic: map(0.0, 0.5, Channel::B),
            roughness: map(1.0, -1.0, Channel::A),
            occlusion: map(0.25, 0.75, Channel::R),
            transmission: map(0.0, 9.0, Channel::G),
            anisotropy: Anisotropy { strength: 0.5, rotation: 0.25, texture: Some(TEXTURE) },
            ..Material::default()
        };
        let meshes = meshes(material, Encoding::Linear, 1, |_, _| [51, 255, 102, 204]);
        let point = seen(&meshes, DVec3::NEG_Z);
        let found = point.parameters;
        let close = |a: f32, b: f32| (a - b).abs() < 1e-6;
        assert!(close(found.metallic, 0.2) && close(found.roughness, 0.2) && close(point.occlusion, 0.4));
        assert_eq!(found.transmission, 1.0);
        // Direction (-0.6, 1), strength 0.4 of the texture.
        assert!(close(found.anisotropy_strength, 0.2));
        assert!(close(found.anisotropy_rotation, 0.25 + 1.0f32.atan2(-0.6)));
    }

    #[test]
    fn a_ray_wider_than_the_texture_sees_its_mean_and_a_thin_one_its_texels() {
        let material = Material { base_colour_texture: Some(TEXTURE), ..Material::default() };
        let checker = |x: u32, y: u32| if (x + y).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 255] };
        let meshes = meshes(material, Encoding::Srgb, 64, checker);
        let seen =
            |direction: DVec3, width: f32| point_of(&meshes, &ray(direction), width).base_colour_and_coverage().0.x;
        for direction in [DVec3::NEG_Z, DVec3::new(1.0, 0.3, -1.0), DVec3::new(1.0, 0.0, -1e-6)] {
            for width in [0.2, 1.0, 1e3] {
                let mean = seen(direction, width);
                assert!((mean - 0.5).abs() < 0.005, "{direction} {width}: {mean}");
            }
        }
        assert!((seen(DVec3::NEG_Z, 1e-6) - seen(DVec3::NEG_Z, 0.0)).abs() < 1e-6);
    }

    #[test]
    fn a_slanted_ray_cuts_an_ellipse_as_long_as_its_width_over_the_cosine() {
        let meshes = meshes(Material::default(), Encoding::Srgb, 1, |_, _| [0; 4]);
        // The corners lie at distance 1 along x and y: barycentric weights are coordinates.
        let point = point_of(&meshes, &ray(DVec3::new(0.0, 3f64.sqrt(), -1.0)), 0.5);
        let [onward, sideways] = point.area.map(Vec2::abs);
        assert!(onward.abs_diff_eq(Vec2::new(0.0, 1.0), 1e-6), "60 degrees double the length: {onward}");
        assert!(sideways.abs_diff_eq(Vec2::new(0.5, 0.0), 1e-6), "{sideways}");
    }
}
