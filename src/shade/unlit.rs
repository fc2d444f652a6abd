//! Surfaces without light on them: emission plus base colour.

use glam::Vec3;

use super::material::SurfacePoint;
use crate::scene::material::AlphaMode;
use crate::scene::{LinearRgb, Meshes};
use crate::trace::{Fragment, Ray, SurfaceHit, Surfaces};

/// The surfaces of `--surface unlit`: they send back emission plus base colour, alike in all directions.
///
/// A material of KHR_materials_unlit sends back its base colour alone.
#[derive(Debug, Clone, Copy)]
pub struct UnlitSurfaces<'a> {
    meshes: &'a Meshes,
    ray_angle: f32,
}

impl<'a> UnlitSurfaces<'a> {
    /// The surfaces of all triangles of `meshes`, for rays without width.
    pub fn new(meshes: &'a Meshes) -> Self {
        Self { meshes, ray_angle: 0.0 }
    }

    /// The same for rays that widen by `ray_angle` radians: textures are averaged over that.
    pub fn for_rays_of(self, ray_angle: f64) -> Self {
        Self { ray_angle: ray_angle as f32, ..self }
    }
}

impl Surfaces for UnlitSurfaces<'_> {
    fn is_opaque(&self, triangle: u32) -> bool {
        self.meshes.material_of(triangle as usize).alpha == AlphaMode::Opaque
    }

    fn is_double_sided(&self, triangle: u32) -> bool {
        self.meshes.material_of(triangle as usize).double_sided
    }

    fn fragment(&self, ray: &Ray, hit: &SurfaceHit) -> Fragment {
        let point = SurfacePoint::new(self.meshes, ray, hit, self.ray_angle * hit.distance as f32);
        if !hit.front && !point.material.double_sided {
            return Fragment { alpha: 0.0, radiance: LinearRgb(Vec3::ZERO) };
        }
        let (base_colour, alpha) = point.base_colour_and_coverage();
        Fragment { alpha, radiance: LinearRgb(base_colour + point.emission().0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use crate::scene::material::TextureRef;
    use crate::scene::mesh::VertexAttributes;
    use crate::scene::texture::{Encoding, Filter, Image, MipFilter, Texture, Wrap};
    use glam::{DVec3, Mat3, Vec2, Vec4};
    use std::sync::Arc;

    const RAY: Ray = Ray { origin: DVec3::Z, direction: DVec3::NEG_Z };

    /// One triangle with corner colours red, green, blue, uv (0, 0), (1, 0), (0, 1), and a 2 x 2 texture.
    fn meshes(material: Material) -> Meshes {
        let vertex = |uv: Vec2, colour: Vec3| VertexAttributes {
            uv: [uv, Vec2::ONE - uv],
            colour: colour.extend(1.0),
            ..VertexAttributes::default()
        };
        let attributes = vec![vertex(Vec2::ZERO, Vec3::X), vertex(Vec2::X, Vec3::Y), vertex(Vec2::Y, Vec3::Z)];
        let rgba = vec![[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 64], [255, 255, 255, 0]];
        let image = Arc::new(Image::new(2, 2, Encoding::Srgb, || Ok(rgba)));
        let filter = Filter { magnify_nearest: true, minify_nearest: true, mips: MipFilter::Linear };
        Meshes {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            attributes,
            triangles: vec![[0, 1, 2]],
            triangle_materials: vec![0],
            materials: vec![material],
            textures: vec![Texture { image, wrap: [Wrap::Repeat; 2], filter }],
            ..Meshes::default()
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
