//! What a probe holds, small: enough to tell how well one probe predicts another.

use glam::{DVec3, Vec3};

use super::interpolate::parallax_corrected;
use super::proxy::{self, Seen};
use crate::error::Result;
use crate::filter::{Prefilter, RgbCubemap, Sampler, ShRadiance, cubemap::solid_angles};
use crate::scene::{Bounds, Scene};
use crate::shade::sampling::fibonacci;
use crate::trace::{Face, Radiance, Tile, TileTracer};

/// Texels along an edge of a face.
pub const FACE_SIZE: u32 = 16;

/// Perceptual roughnesses that predictions are judged at, beside diffuse irradiance. The lobe of the first is a tenth of
/// a texel wide, so that the cubemap itself stands for it; the others' leave no more detail than small faces hold, of these
/// sizes.
pub const ROUGHNESS: [f64; 3] = [0.1, 0.3, 0.6];
const SIZES: [u32; 2] = [8, 4];

/// Directions in which reflections are compared, and normals for irradiance.
const DIRECTIONS: usize = 48;
const NORMALS: usize = 16;

/// Kinds of light in a [`Signal::view`]: the roughnesses, then diffuse irradiance.
pub const KINDS: usize = ROUGHNESS.len() + 1;

/// Added to the mean square of the truth: what is as dark as a hundredth of paper white counts as that bright.
const DARKEST: f32 = 1e-4;

/// A probe that is small and prefiltered.
pub struct Signal {
    /// Where it was traced, in metres, world space.
    pub position: DVec3,
    /// The box that reflections are corrected against.
    pub proxy: Bounds,
    specular: [Sampler; ROUGHNESS.len()],
    diffuse: ShRadiance,
}

impl Signal {
    /// Traces a cubemap at `position`.
    ///
    /// Fails when a traced value is not finite.
    pub fn trace(tracer: &dyn TileTracer, scene: &Scene, position: DVec3) -> Result<Self> {
        let mut texels = Vec::new();
        let mut seen = Vec::new();
        let angles = solid_angles(FACE_SIZE);
        let mut rays = vec![Radiance::default(); angles.len()];
        for face in Face::ALL {
            let tile = Tile { face, face_size: FACE_SIZE, x: 0, y: 0, width: FACE_SIZE, height: FACE_SIZE };
            tracer.trace_tile(position - scene.origin, &tile, &mut rays);
            texels.extend(
                rays.iter()
                    .zip(tile.directions())
                    .map(|(ray, direction)| ray.to_linear(scene.encoding, scene.background_along(direction)).0),
            );
            // One ray of four tells where walls are.
            let quarter = rays.iter().zip(tile.directions()).zip(&angles).enumerate();
            let quarter = quarter.filter(|(i, _)| i % 2 == 0 && (i / FACE_SIZE as usize).is_multiple_of(2));
            seen.extend(quarter.map(|(_, ((ray, direction), &weight))| {
                let is_covered = ray.coverage() > 0.5;
                let distance = if is_covered { f64::from(ray.mean_distance()) } else { f64::INFINITY };
                Seen { direction, distance, weight }
            }));
        }
        let cubemap = RgbCubemap::new(FACE_SIZE, texels)?;
        let diffuse = ShRadiance::project(&cubemap, 2);
        let source = Prefilter::new(cubemap);
        let [glossy, rough] = [0, 1].map(|i| Sampler::new(&source.specular(ROUGHNESS[i + 1], SIZES[i])));
        let specular = [source.mirror().clone(), glossy, rough];
        Ok(Self { position, proxy: proxy::fit(position, &seen), specular, diffuse })
    }

    /// What the probe shows at `position`, as a runtime looks it up: reflections in [`DIRECTIONS`] directions per
    /// roughness, corrected for parallax, then irradiance over pi for [`NORMALS`] normals.
    pub fn view(&self, position: DVec3) -> Vec<Vec3> {
        let mut view = Vec::with_capacity(DIRECTIONS * ROUGHNESS.len() + NORMALS);
        let directions: Vec<Vec3> = (0..DIRECTIONS)
            .map(|i| parallax_corrected(self.position, &self.proxy, position, fibonacci(i, DIRECTIONS)).as_vec3())
            .collect();
        for mip in &self.specular {
            view.extend(directions.iter().map(|&direction| mip.radiance(direction)));
        }
        view.extend((0..NORMALS).map(|i| self.diffuse.irradiance(fibonacci(i, NORMALS)).as_vec3()));
        view
    }

    /// What is truly there, where the probe was taken.
    pub fn truth(&self) -> Vec<Vec3> {
        self.view(self.position)
    }
}

/// Relative error of a predicted view per kind of light: root mean square of the differences over that of the truth.
pub fn errors(predicted: &[Vec3], truth: &[Vec3]) -> [f64; KINDS] {
    std::array::from_fn(|kind| {
        let start = kind * DIRECTIONS;
        let range = start..(start + DIRECTIONS).min(truth.len());
        let (mut difference, mut power) = (0.0, 0.0);
        for (p, t) in predicted[range.clone()].iter().zip(&truth[range.clone()]) {
            difference += (*p - *t).length_squared();
            power += t.length_squared() + DARKEST;
        }
        f64::from(difference / power).sqrt()
    })
}

/// Mean over the kinds of light of the relative errors.
pub fn error(predicted: &[Vec3], truth: &[Vec3]) -> f64 {
    errors(predicted, truth).iter().sum::<f64>() / KINDS as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::LinearRgb;
    use crate::scene::environment::EnvironmentMap;

    /// A room's walls, lit by where they are.
    struct Room(Bounds);

    impl TileTracer for Room {
        fn trace_tile(&self, origin: DVec3, tile: &Tile, texels: &mut [Radiance]) {
            for (texel, direction) in texels.iter_mut().zip(tile.directions()) {
                let distance = super::super::interpolate::exit_distance(&self.0, origin, direction);
                let wall = (origin + direction * distance).as_vec3();
                *texel = Radiance {
                    surface_sum: wall.abs(),
                    distance_sum: distance as f32,
                    transmittance: 0.0,
                    ..Radiance::default()
                };
            }
        }
    }

    const ROOM: Bounds = Bounds { min: DVec3::new(-2.0, -1.5, -2.5), max: DVec3::new(3.0, 1.2, 2.0) };

    #[test]
    fn in_a_room_that_is_a_box_one_probe_predicts_all_but_texels() {
        let scene = Scene { background: LinearRgb::default(), ..Scene::default() };
        let [here, there] = [DVec3::new(0.3, 0.1, 0.2), DVec3::new(-0.7, -0.4, 0.9)]
            .map(|at| Signal::trace(&Room(ROOM), &scene, at).unwrap());
        assert!((here.proxy.min - ROOM.min).abs().max_element() < 1e-3, "{:?}", here.proxy);
        assert_eq!(errors(&here.truth(), &here.truth()), [0.0; KINDS]);
        let [mirror, glossy, rough, _] = errors(&here.view(there.position), &there.truth());
        // The rougher, the less a lobe is a single direction that a box can correct.
        assert!(mirror < 0.03 && glossy < 0.08 && rough < 0.2, "{mirror} {glossy} {rough}");
        // Without parallax it does not.
        let [flat, ..] = errors(&here.truth(), &there.truth());
        assert!(flat > 3.0 * mirror, "{flat}");
    }

    #[test]
    fn an_open_sky_is_seen_where_it_is_bright() {
        /// Nothing at all.
        struct Air;
        impl TileTracer for Air {
            fn trace_tile(&self, _: DVec3, _: &Tile, texels: &mut [Radiance]) {
                texels.fill(Radiance::default());
            }
        }
        // Red above, blue below.
        let halves = [Vec3::X, Vec3::Z].into_iter().flat_map(|colour| [colour; 128 * 32]).collect();
        let environment = EnvironmentMap::new(128, 64, halves);
        assert!(environment.is_some());
        let scene = Scene { environment, ..Scene::default() };
        let truth = Signal::trace(&Air, &scene, DVec3::ZERO).unwrap().truth();
        for (i, seen) in truth.iter().take(DIRECTIONS).enumerate() {
            let up = fibonacci(i, DIRECTIONS).y;
            // Two texels' width away from the horizon.
            if up.abs() > 0.25 {
                let colour = if up > 0.0 { Vec3::X } else { Vec3::Z };
                assert!((*seen - colour).abs().max_element() < 1e-3, "{up}: {seen}");
            }
        }
    }

    #[test]
    fn errors_are_relative() {
        let truth = vec![Vec3::splat(2.0); DIRECTIONS * 3 + NORMALS];
        let predicted = vec![Vec3::splat(2.2); truth.len()];
        assert!((error(&predicted, &truth) - 0.1).abs() < 1e-4);
    }
}
