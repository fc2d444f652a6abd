//! Lights without extent (KHR_lights_punctual): directions, points and cones.

use glam::Vec3;

use super::LinearRgb;

/// A light that only shows on what it lights.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Name in the file, for messages.
    pub name: String,
    /// Where it stands and where it shines.
    pub kind: LightKind,
    /// Colour times intensity. Of a directional light the irradiance on a surface that faces it; of the others the
    /// intensity (power per solid angle), which is the irradiance at one metre. A white diffuse surface shows irradiance
    /// pi as radiance 1.
    pub intensity: LinearRgb,
}

/// Where a light stands, in metres relative to the scene origin, and where it shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// From infinitely far away.
    Directional {
        /// Unit direction in which light travels.
        direction: Vec3,
    },
    /// In all directions.
    Point {
        /// Where it stands.
        position: Vec3,
        /// Distance at which it has faded to nothing, in metres; infinite for the plain inverse square.
        range: f32,
    },
    /// Into a cone.
    Spot {
        /// Where it stands.
        position: Vec3,
        /// Unit direction of the cone's axis, away from the light.
        direction: Vec3,
        /// Angle from the axis at which it begins to fade, in radians, below `outer_cone`.
        inner_cone: f32,
        /// Angle from the axis at which it has faded to nothing, at most pi / 2.
        outer_cone: f32,
        /// As for a point.
        range: f32,
    },
}

/// What arrives at a point from a light, if nothing stands between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Incident {
    /// Unit direction from the point to the light.
    pub to_light: Vec3,
    /// Metres to the light; infinite for a directional one.
    pub distance: f32,
    /// Irradiance on a surface at the point that faces the light.
    pub irradiance: LinearRgb,
}

impl Light {
    /// What arrives at `point` (metres relative to the scene origin); `None` for nothing.
    ///
    /// Range and cone fade as KHR_lights_punctual recommends.
    pub fn incident_at(&self, point: Vec3) -> Option<Incident> {
        let (position, range) = match self.kind {
            LightKind::Directional { direction } => {
                return Some(Incident { to_light: -direction, distance: f32::INFINITY, irradiance: self.intensity });
            }
            LightKind::Point { position, range } | LightKind::Spot { position, range, .. } => (position, range),
        };
        let offset = position - point;
        let distance = offset.length();
        let to_light = offset / distance;
        // 0 / range is 0 for an infinite range.
        let within_range = (1.0 - (distance / range).powi(4)).clamp(0.0, 1.0);
        let share = self.share_toward(-to_light) * within_range / (distance * distance);
        // At the light itself there is no direction, and no finite irradiance.
        (share > 0.0 && share.is_finite() && to_light.is_finite()).then(|| Incident {
            to_light,
            distance,
            irradiance: LinearRgb(self.intensity.0 * share),
        })
    }

    /// Share of the intensity that leaves in a unit `direction`.
    fn share_toward(&self, direction: Vec3) -> f32 {
        let LightKind::Spot { direction: axis, inner_cone, outer_cone, .. } = self.kind else { return 1.0 };
        let (inner, outer) = (inner_cone.cos(), outer_cone.cos());
        // The extension's guard against cones that end where they begin.
        let fade = ((axis.dot(direction) - outer) / (inner - outer).max(0.001)).clamp(0.0, 1.0);
        fade * fade
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{FRAC_PI_3, FRAC_PI_6};

    const POINT: LightKind = LightKind::Point { position: Vec3::new(0.0, 2.0, 0.0), range: f32::INFINITY };

    fn irradiance(kind: LightKind, point: Vec3) -> f32 {
        let light = Light { name: String::new(), kind, intensity: LinearRgb(Vec3::new(8.0, 0.0, 0.0)) };
        light.incident_at(point).map_or(0.0, |incident| incident.irradiance.0.x)
    }

    #[test]
    fn points_fall_with_the_square_of_distance_and_to_nothing_at_their_range() {
        assert_eq!(irradiance(POINT, Vec3::ZERO), 2.0);
        assert_eq!(irradiance(POINT, Vec3::new(0.0, 1.0, 0.0)), 8.0);
        let ranged = LightKind::Point { position: Vec3::new(0.0, 2.0, 0.0), range: 4.0 };
        assert_eq!(irradiance(ranged, Vec3::ZERO), 2.0 * (1.0 - 1.0 / 16.0));
        assert_eq!(irradiance(ranged, Vec3::new(0.0, -2.0, 0.0)), 0.0);
        assert_eq!(irradiance(ranged, Vec3::new(0.0, -9.0, 0.0)), 0.0);
    }

    #[test]
    fn directions_shine_everywhere_alike_from_where_they_come() {
        let kind = LightKind::Directional { direction: Vec3::NEG_Y };
        let light = Light { name: String::new(), kind, intensity: LinearRgb(Vec3::ONE) };
        let incident = light.incident_at(Vec3::splat(1e6)).unwrap();
        assert_eq!((incident.to_light, incident.distance), (Vec3::Y, f32::INFINITY));
        assert_eq!(incident.irradiance, LinearRgb(Vec3::ONE));
    }

    #[test]
    fn spots_are_full_inside_the_inner_cone_and_dark_outside_the_outer() {
        let spot = |inner_cone| LightKind::Spot {
            position: Vec3::ZERO,
            direction: Vec3::NEG_Z,
            inner_cone,
            outer_cone: FRAC_PI_3,
            range: f32::INFINITY,
        };
        let at = |inner, angle: f32| irradiance(spot(inner), Vec3::new(angle.sin(), 0.0, -angle.cos()));
        assert!((at(FRAC_PI_6, 0.0) - 8.0).abs() < 1e-5);
        assert!((at(FRAC_PI_6, 0.99 * FRAC_PI_6) - 8.0).abs() < 1e-5);
        assert_eq!(at(FRAC_PI_6, 1.01 * FRAC_PI_3), 0.0);
        // Halfway between the cosines, a quarter.
        let middle = (0.5 * (FRAC_PI_6.cos() + FRAC_PI_3.cos())).acos();
        assert!((at(FRAC_PI_6, middle) - 2.0).abs() < 1e-4);
        assert!(at(FRAC_PI_3, 0.99 * FRAC_PI_3).is_finite());
    }

    #[test]
    fn nothing_arrives_at_the_light_itself() {
        let light = Light { name: String::new(), kind: POINT, intensity: LinearRgb(Vec3::ONE) };
        assert_eq!(light.incident_at(Vec3::new(0.0, 2.0, 0.0)), None);
    }
}
