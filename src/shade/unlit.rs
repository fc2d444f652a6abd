//! Surfaces without light on them: emission plus base colour.

use glam::{Vec3, Vec4, Vec4Swizzles};

use super::texture::sample;
use crate::scene::LinearRgb;
use crate::scene::mesh::{AlphaMode, Material, Meshes, TextureRef, VertexAttributes};
use crate::trace::{Fragment, Ray, SurfaceHit, Surfaces};

/// The surfaces of `--surface unlit`: they send back emission plus base colour, alike in all directions.
///
/// A material of KHR_materials_unlit sends back its base colour alone.
#[derive(Debug, Clone, Copy)]
pub struct UnlitSurfaces<'a> {
    meshes: &'a Meshes,
}

impl<'a> UnlitSurfaces<'a> {
    /// The surfaces of all triangles of `meshes`.
    pub fn new(meshes: &'a Meshes) -> Self {
        Self { meshes }
    }

    /// Attributes at a hit, between those of the triangle's corners.
    fn attributes_at(&self, hit: &SurfaceHit) -> VertexAttributes {
        let [a, b, c] = self.meshes.triangles[hit.triangle as usize].map(|v| &self.meshes.attributes[v as usize]);
        let (to_b, to_c) = (hit.barycentric.x, hit.barycentric.y);
        let to_a = 1.0 - to_b - to_c;
        let uv = |set: usize| a.uv[set] * to_a + b.uv[set] * to_b + c.uv[set] * to_c;
        VertexAttributes {
            normal: a.normal * to_a + b.normal * to_b + c.normal * to_c,
            uv: [uv(0), uv(1)],
            colour: a.colour * to_a + b.colour * to_b + c.colour * to_c,
        }
    }

    fn texture_at(&self, texture: Option<&TextureRef>, at: &VertexAttributes) -> Vec4 {
        texture.map_or(Vec4::ONE, |texture| {
            let uv = texture.uv_from_uv.transform_point2(at.uv[usize::from(texture.uv_set)]);
            sample(&self.meshes.textures[texture.texture as usize], uv)
        })
    }
}

impl Surfaces for UnlitSurfaces<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        self.meshes.material_of(triangle as usize).alpha == AlphaMode::Opaque
    }

    fn is_double_sided(&self, triangle: u32) -> bool {
        self.meshes.material_of(triangle as usize).double_sided
    }

    fn fragment(&self, _ray: &Ray, hit: &SurfaceHit) -> Fragment {
        let material = self.meshes.material_of(hit.triangle as usize);
        if !hit.front && !material.double_sided {
            return Fragment { alpha: 0.0, radiance: LinearRgb::default() };
        }
        let at = self.attributes_at(hit);
        let base = material.base_colour * at.colour * self.texture_at(material.base_colour_texture.as_ref(), &at);
        let emission = if material.unlit || material.emissive.0 == Vec3::ZERO {
            Vec3::ZERO
        } else {
            material.emissive.0 * self.texture_at(material.emissive_texture.as_ref(), &at).xyz()
        };
        Fragment { alpha: coverage(material, base.w), radiance: LinearRgb(base.xyz() + emission) }
    }
}

/// What a material makes of the alpha of its base colour (glTF 2.0, section 3.9.4).
fn coverage(material: &Material, alpha: f32) -> f32 {
    match material.alpha {
        AlphaMode::Opaque => 1.0,
        AlphaMode::Mask { cutoff } => f32::from(u8::from(alpha >= cutoff)),
        AlphaMode::Blend => alpha.clamp(0.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::mesh::{Texture, Wrap};
    use glam::{DVec3, Mat3, Vec2};

    const RAY: Ray = Ray { origin: DVec3::Z, direction: DVec3::NEG_Z };

    /// One triangle with corner colours red, green, blue, uv (0, 0), (1, 0), (0, 1), and a 2 x 2 texture.
    fn meshes(material: Material) -> Meshes {
        let vertex = |uv: Vec2, colour: Vec3| VertexAttributes {
            uv: [uv, Vec2::ONE - uv],
            colour: colour.extend(1.0),
            ..VertexAttributes::default()
        };
        let attributes = vec![vertex(Vec2::ZERO, Vec3::X), vertex(Vec2::X, Vec3::Y), vertex(Vec2::Y, Vec3::Z)];
        let rgba = [[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 64], [255, 255, 255, 0]];
        Meshes {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            attributes,
            triangles: vec![[0, 1, 2]],
            triangle_materials: vec![0],
            materials: vec![material],
            textures: vec![Texture { width: 2, height: 2, rgba: rgba.into(), wrap: [Wrap::Repeat; 2], nearest: true }],
        }
    }

    fn white_corners(material: Material) -> Meshes {
        let mut meshes = meshes(material);
        meshes.attributes.iter_mut().for_each(|a| a.colour = Vec4::ONE);
        meshes
    }

    fn hit(second: f32, third: f32, front: bool) -> SurfaceHit {
        SurfaceHit { triangle: 0, barycentric: Vec2::new(second, third), front, distance: 1.0 }
    }

    fn texture_ref(uv_set: u8, uv_from_uv: Mat3) -> Option<TextureRef> {
        Some(TextureRef { texture: 0, uv_set, uv_from_uv })
    }

    #[test]
    fn barycentrics_weight_the_second_and_third_corner() {
        let meshes = meshes(Material::default());
        let fragment = UnlitSurfaces::new(&meshes).fragment(&RAY, &hit(0.25, 0.125, true));
        assert_eq!(fragment, Fragment { alpha: 1.0, radiance: LinearRgb(Vec3::new(0.625, 0.25, 0.125)) });
    }

    #[test]
    fn radiance_is_emission_plus_base_colour_and_unlit_materials_have_no_emission() {
        let lit = Material {
            base_colour: Vec4::new(0.5, 0.25, 0.125, 1.0),
            base_colour_texture: texture_ref(0, Mat3::IDENTITY),
            emissive: LinearRgb(Vec3::new(10.0, 20.0, 30.0)),
            emissive_texture: texture_ref(1, Mat3::IDENTITY),
            ..Material::default()
        };
        // At uv 0 = (0.75, 0.25) the texture is green; uv 1 = (0.25, 0.75) is blue.
        let at = hit(0.75, 0.25, true);
        let both = white_corners(lit.clone());
        assert_eq!(UnlitSurfaces::new(&both).fragment(&RAY, &at).radiance, LinearRgb(Vec3::new(0.0, 0.25, 30.0)));
        let unlit = white_corners(Material { unlit: true, ..lit });
        assert_eq!(UnlitSurfaces::new(&unlit).fragment(&RAY, &at).radiance, LinearRgb(Vec3::new(0.0, 0.25, 0.0)));
    }

    #[test]
    fn texture_transforms_move_the_look_up() {
        let shifted = Mat3::from_translation(Vec2::new(0.5, 0.0));
        let material = Material { base_colour_texture: texture_ref(0, shifted), ..Material::default() };
        let meshes = white_corners(material);
        let fragment = UnlitSurfaces::new(&meshes).fragment(&RAY, &hit(0.25, 0.25, true));
        assert_eq!(fragment.radiance, LinearRgb(Vec3::Y));
    }

    #[test]
    fn alpha_modes_ignore_test_or_blend() {
        let alpha_at_green = |alpha| {
            let material =
                Material { alpha, base_colour_texture: texture_ref(0, Mat3::IDENTITY), ..Material::default() };
            let meshes = white_corners(material);
            let surfaces = UnlitSurfaces::new(&meshes);
            (surfaces.is_opaque(0), surfaces.fragment(&RAY, &hit(0.75, 0.25, true)).alpha)
        };
        let green = 128.0 / 255.0;
        assert_eq!(alpha_at_green(AlphaMode::Opaque), (true, 1.0));
        assert_eq!(alpha_at_green(AlphaMode::Mask { cutoff: green }), (false, 1.0));
        assert_eq!(alpha_at_green(AlphaMode::Mask { cutoff: green + 0.001 }), (false, 0.0));
        assert_eq!(alpha_at_green(AlphaMode::Blend), (false, green));
    }

    #[test]
    fn backs_are_seen_only_when_double_sided() {
        for double_sided in [false, true] {
            let meshes = white_corners(Material { double_sided, ..Material::default() });
            let surfaces = UnlitSurfaces::new(&meshes);
            assert_eq!(surfaces.is_double_sided(0), double_sided);
            let alpha = surfaces.fragment(&RAY, &hit(0.2, 0.2, false)).alpha;
            assert_eq!(alpha, f32::from(u8::from(double_sided)));
        }
    }
}
