//! The immutable scene: Gaussians, triangles and textures in one canonical frame, ready to trace.

pub mod bounds;
pub mod colour;
pub mod environment;
pub mod light;
pub mod material;
pub mod mesh;
pub mod sh;
pub mod splats;
pub mod texture;

pub use bounds::Bounds;
pub use colour::{DisplayRgb, LinearRgb, SplatEncoding};
pub use environment::EnvironmentMap;
pub use light::Light;
pub use material::Material;
pub use mesh::Meshes;
pub use splats::Splats;

use glam::{DVec3, Vec3};

/// Everything that can be seen, in the canonical frame (right-handed, +Y up, metres).
#[derive(Debug, Default, Clone)]
pub struct Scene {
    /// World position, in metres, of the point that all stored f32 positions are relative to.
    ///
    /// It is (0, 0, 0) unless the scene lies so far from zero that f32 world coordinates would lose detail.
    pub origin: DVec3,
    /// The Gaussians of all splat inputs.
    pub splats: Splats,
    /// The triangles of all mesh inputs.
    pub meshes: Meshes,
    /// The lights without extent of all mesh inputs.
    pub lights: Vec<Light>,
    /// How the splats' colours are encoded; decides the conversion after blending. In a scene of mixed encodings, that
    /// of the Gaussians that are not [linear](Splats::linear).
    pub encoding: SplatEncoding,
    /// Linear radiance of rays that leave the scene.
    pub background: LinearRgb,
    /// The same by direction, instead.
    pub environment: Option<EnvironmentMap>,
}

impl Scene {
    /// A world position as the offset from the scene's origin that positions are stored as.
    pub fn relative(&self, world: DVec3) -> Vec3 {
        (world - self.origin).as_vec3()
    }

    /// Radiance of rays that leave the scene along `direction`.
    pub fn background_along(&self, direction: DVec3) -> LinearRgb {
        self.environment.as_ref().map_or(self.background, |map| map.radiance(direction))
    }
}
