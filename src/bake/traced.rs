//! What was traced for a probe, whole and tile by tile.

use bytemuck::{Pod, Zeroable};

use super::{BakeSettings, Cubemap, DistanceStatistics, ProbeStatistics};

/// What the rays of a probe brought.
#[derive(Debug, Clone, PartialEq)]
pub struct Traced {
    /// Means over texels.
    pub cubemap: Cubemap,
    /// Sums over each of [`BakeSettings::tiles`].
    pub tiles: Vec<TileSums>,
}

impl Traced {
    /// What the probe sees, in numbers; `settings` are those that it was traced with.
    pub fn statistics(&self, settings: &BakeSettings) -> ProbeStatistics {
        let sums = self.tiles.iter().fold(TileSums::default(), |sums, tile| sums.merged(tile));
        let texels = 6.0 * f64::from(settings.face_size).powi(2);
        ProbeStatistics {
            rays: settings.rays_per_probe(),
            mean_coverage: sums.coverage / texels,
            distance: (sums.coverage > 0.0).then(|| DistanceStatistics {
                min: f64::from(sums.min_distance),
                mean: sums.distance / sums.coverage,
                max: f64::from(sums.max_distance),
            }),
            hidden_backs: None,
            surface_noise: None,
        }
    }
}

/// A probe as it was traced before, and which of its tiles are still true.
#[derive(Debug, Clone)]
pub struct Earlier {
    /// What was traced.
    pub traced: Traced,
    /// Whether each of [`BakeSettings::tiles`] is kept.
    pub kept: Vec<bool>,
}

impl Earlier {
    pub(super) fn fits(&self, settings: &BakeSettings) -> bool {
        let Traced { cubemap, tiles } = &self.traced;
        let texels = 6 * (settings.face_size as usize).pow(2);
        let distances = cubemap.distance.as_ref().map(Vec::len);
        cubemap.face_size == settings.face_size
            && cubemap.texels.len() == texels
            && distances == settings.distance.then_some(texels)
            && tiles.len() == settings.tiles().len()
            && self.kept.len() == tiles.len()
    }
}

/// Sums over texels, for statistics.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TileSums {
    /// Sum of coverage.
    pub coverage: f64,
    /// Sum of coverage times distance, in metres.
    pub distance: f64,
    /// Least distance of a texel with coverage, in metres; infinite without any.
    pub min_distance: f32,
    /// Largest, in metres.
    pub max_distance: f32,
}

impl Default for TileSums {
    fn default() -> Self {
        Self { coverage: 0.0, distance: 0.0, min_distance: f32::INFINITY, max_distance: 0.0 }
    }
}

impl TileSums {
    pub(super) fn add(&mut self, coverage: f32, distance: f32) {
        if coverage > 0.0 {
            self.coverage += f64::from(coverage);
            self.distance += f64::from(coverage) * f64::from(distance);
            self.min_distance = self.min_distance.min(distance);
            self.max_distance = self.max_distance.max(distance);
        }
    }

    fn merged(self, other: &Self) -> Self {
        Self {
            coverage: self.coverage + other.coverage,
            distance: self.distance + other.distance,
            min_distance: self.min_distance.min(other.min_distance),
            max_distance: self.max_distance.max(other.max_distance),
        }
    }
}
