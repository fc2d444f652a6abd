//! What shines on surfaces by itself: lights without extent, and triangles that emit.

use glam::{DVec3, Vec3};

use crate::scene::light::Incident;
use crate::scene::{Light, LinearRgb, Meshes};

/// All lights that surfaces can be lit by directly.
#[derive(Debug)]
pub struct Lights<'a> {
    meshes: &'a Meshes,
    punctual: &'a [Light],
    /// Triangles that emit, and the sums of their weights up to and with each.
    emitters: Vec<u32>,
    weight_sums: Vec<f64>,
}

/// A light without extent as a point sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PunctualSample {
    /// What arrives.
    pub incident: Incident,
    /// Probability of drawing this light.
    pub probability: f32,
}

/// A point on a triangle that emits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EmitterSample {
    /// Its triangle.
    pub triangle: u32,
    /// Where it is, in metres relative to the scene origin.
    pub position: DVec3,
}

impl<'a> Lights<'a> {
    /// The lights of a scene, in the order of its triangles.
    pub fn new(meshes: &'a Meshes, punctual: &'a [Light]) -> Self {
        let mut lights = Self { meshes, punctual, emitters: Vec::new(), weight_sums: Vec::new() };
        let mut sum = 0.0;
        for triangle in 0..meshes.triangles.len() as u32 {
            let power = f64::from(lights.emitter_radiance(triangle)) * lights.area(triangle);
            if power > 0.0 && power.is_finite() {
                sum += power;
                lights.emitters.push(triangle);
                lights.weight_sums.push(sum);
            }
        }
        lights
    }

    /// Whether there is no punctual light.
    pub fn has_no_punctual(&self) -> bool {
        self.punctual.is_empty()
    }

    /// Whether no triangle emits.
    pub fn has_no_emitters(&self) -> bool {
        self.emitters.is_empty()
    }

    /// Draws one of the punctual lights by the irradiance that it would give `point`; `random` lies in [0, 1).
    pub fn sample_punctual(&self, point: Vec3, random: f32) -> Option<PunctualSample> {
        let strength = |light: &Light| {
            let incident = light.incident_at(point)?;
            let strength = incident.irradiance.0.element_sum();
            (strength > 0.0 && strength.is_finite()).then_some((incident, strength))
        };
        let total: f32 = self.punctual.iter().filter_map(&strength).map(|(_, strength)| strength).sum();
        let mut rest = random * total;
        let mut drawn = None;
        for (incident, strength) in self.punctual.iter().filter_map(strength) {
            drawn = Some(PunctualSample { incident, probability: strength / total });
            rest -= strength;
            if rest < 0.0 {
                break;
            }
        }
        drawn
    }

    /// Draws a point on a triangle that emits, by area and brightness; `random` lies in [0, 1)^3.
    pub fn sample_emitter(&self, random: [f32; 3]) -> Option<EmitterSample> {
        let total = *self.weight_sums.last()?;
        let drawn = f64::from(random[0]) * total;
        let index = self.weight_sums.partition_point(|sum| *sum <= drawn).min(self.emitters.len() - 1);
        let triangle = self.emitters[index];
        // Uniform over the triangle (Osada et al. 2002).
        let root = f64::from(random[1]).sqrt();
        let (b, c) = (root * (1.0 - f64::from(random[2])), root * f64::from(random[2]));
        let [p, q, r] = self.meshes.corners(triangle as usize).map(|corner| corner.as_dvec3());
        Some(EmitterSample { triangle, position: p + (q - p) * b + (r - p) * c })
    }

    /// Density, per solid angle, with which [`Self::sample_emitter`] draws the direction of a point of `triangle` that lies
    /// `distance` metres away and whose normal makes an angle of that cosine with it. 0 for triangles that do not emit.
    pub fn emitter_density(&self, triangle: u32, distance: f64, cosine: f64) -> f32 {
        let Some(total) = self.weight_sums.last() else { return 0.0 };
        // The triangle's weight, divided by its area.
        let radiance = f64::from(self.emitter_radiance(triangle));
        if radiance == 0.0 || self.emitters.binary_search(&triangle).is_err() {
            return 0.0;
        }
        (radiance / total * distance * distance / cosine.abs().max(1e-9)) as f32
    }

    /// Brightness of a triangle before its texture, for drawing; unlit surfaces look bright, but do not emit.
    fn emitter_radiance(&self, triangle: u32) -> f32 {
        let material = self.meshes.material_of(triangle as usize);
        let LinearRgb(emissive) = material.emissive;
        if material.unlit { 0.0 } else { emissive.element_sum() }
    }

    fn area(&self, triangle: u32) -> f64 {
        let [a, b, c] = self.meshes.corners(triangle as usize).map(|corner| corner.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use crate::scene::light::LightKind;
    use crate::scene::mesh::VertexAttributes;

    /// Two emitting triangles, one of twice the area and brightness, and one that is dark.
    fn meshes() -> Meshes {
        let emitter = |value| Material { emissive: LinearRgb(Vec3::splat(value)), ..Material::default() };
        let right = |x: f32, edge: f32| [Vec3::X * x, Vec3::X * (x + edge), Vec3::X * x + Vec3::Y * edge];
        Meshes {
            positions: [right(0.0, 1.0), right(2.0, 2f32.sqrt()), right(5.0, 1.0)].concat(),
            attributes: vec![VertexAttributes::default(); 9],
            triangles: vec![[0, 1, 2], [3, 4, 5], [6, 7, 8]],
            triangle_materials: vec![0, 1, 2],
            materials: vec![emitter(1.0), emitter(2.0), emitter(0.0)],
            ..Meshes::default()
        }
    }

    #[test]
    fn emitters_are_drawn_by_area_and_brightness_uniformly_over_each() {
        let meshes = meshes();
        let lights = Lights::new(&meshes, &[]);
        let mut counts = [0; 3];
        let mut mean = DVec3::ZERO;
        for i in 0..4096 {
            let [u, v, w, _] = crate::shade::sampling::Sampler::new(5, i).next_four();
            let sample = lights.sample_emitter([u, v, w]).unwrap();
            counts[sample.triangle as usize] += 1;
            if sample.triangle == 0 {
                mean += sample.position;
            }
        }
        assert!((i32::abs(counts[1] - 4 * counts[0]) as f32) < 20.0 && counts[2] == 0, "{counts:?}");
        assert!((mean / f64::from(counts[0]) - DVec3::new(1.0, 1.0, 0.0) / 3.0).length() < 0.02);
        // Over all directions the densities of a triangle seen from afar sum to its probability.
        let solid_angle = 0.5 / 100.0f32;
        assert!((lights.emitter_density(0, 10.0, 1.0) * solid_angle - 0.2).abs() < 1e-3);
        assert_eq!(lights.emitter_density(2, 10.0, 1.0), 0.0);
    }

    #[test]
    fn punctual_lights_are_drawn_by_what_they_give_and_broken_ones_never() {
        let light = |x: f32, intensity: f32| Light {
            name: String::new(),
            kind: LightKind::Point { position: Vec3::X * x, range: f32::INFINITY },
            intensity: LinearRgb(Vec3::splat(intensity)),
        };
        let meshes = Meshes::default();
        let punctual = [light(1.0, 1.0), light(2.0, 12.0), light(3.0, 0.0), light(4.0, f32::INFINITY)];
        let lights = Lights::new(&meshes, &punctual);
        let drawn = |random| lights.sample_punctual(Vec3::ZERO, random).unwrap();
        assert_eq!((drawn(0.1).probability, drawn(0.1).incident.distance), (0.25, 1.0));
        assert_eq!((drawn(0.9).probability, drawn(0.9).incident.distance), (0.75, 2.0));
        assert!(Lights::new(&meshes, &punctual[2..]).sample_punctual(Vec3::ZERO, 0.5).is_none());
    }
}
