//! UsdLux lights that have a counterpart without extent: directions, points and cones.

use glam::{DAffine3, DVec3, Vec3};
use openusd::usd::Prim;

use super::OpenedStage;
use super::meshes::Notes;
use super::network;
use crate::Result;
use crate::scene::LinearRgb;
use crate::scene::light::{Light, LightKind};

/// Lights that are left out, and what to do instead.
const LEFT_OUT: [(&str, &str); 8] = [
    ("RectLight", "make it an emissive Mesh"),
    ("DiskLight", "make it an emissive Mesh"),
    ("CylinderLight", "make it an emissive Mesh"),
    ("GeometryLight", "make it an emissive Mesh"),
    ("PortalLight", "it only guides sampling"),
    ("DomeLight", "give its image as the background of the bake"),
    ("DomeLight_1", "give its image as the background of the bake"),
    ("PluginLight", "it means something to one renderer only"),
];

/// Softest edge that a cone without one is given: a share of its angle.
const LEAST_SOFTNESS: f32 = 1e-3;

/// What a prim is that may be a light.
pub enum Found {
    NoLight,
    /// A light that gives no light.
    Dark,
    Light(Light),
}

/// The light that `prim`, of type `kind`, is.
///
/// `stored_from_prim` leads to the scene's coordinates, in which a unit of the stage is `stage_unit` metres. The amounts are those
/// of UsdLuxLightAPI: a sphere of radiance L and radius r has the intensity pi r^2 L, a sun of half angle a the irradiance
/// pi sin^2(a) L.
pub fn read(
    stage: &OpenedStage,
    prim: &Prim,
    kind: &str,
    stored_from_prim: DAffine3,
    stage_unit: f64,
    notes: &mut Notes,
) -> Result<Found> {
    if let Some((_, instead)) = LEFT_OUT.iter().find(|(left_out, _)| *left_out == kind) {
        notes.add(&format!("{kind} is left out: {instead}"), prim);
        return Ok(Found::NoLight);
    }
    if !matches!(kind, "DistantLight" | "SphereLight") {
        return Ok(Found::NoLight);
    }
    let number = |name: &str, default: f32| network::parameters(stage, prim, name, [default]).map(|[value]| value);
    let flag = |name: &str| network::flag(stage, prim, name);
    let intensity = number("intensity", if kind == "DistantLight" { 50_000.0 } else { 1.0 })?;
    let colour = Vec3::from(network::parameters(stage, prim, "color", [1.0; 3])?);
    if flag("enableColorTemperature")? {
        notes.add("colour temperatures of lights are left out: give their color", prim);
    }
    let radiance = colour * intensity * number("exposure", 0.0)?.exp2();
    if !radiance.is_finite() || radiance.min_element() < 0.0 {
        return Err(stage.invalid(prim, "its intensity, exposure and color must be finite and not negative together"));
    }
    let normalized = flag("normalize")?;
    let position = stored_from_prim.translation.as_vec3();
    let direction = stored_from_prim.transform_vector3(DVec3::NEG_Z).normalize_or_zero().as_vec3();
    let (kind, amount) = if kind == "DistantLight" {
        let half_angle = (number("angle", 0.53)?.to_radians() / 2.0).clamp(0.0, std::f32::consts::PI);
        let amount = if normalized { 1.0 } else { sun_size(half_angle) };
        (LightKind::Directional { direction }, amount)
    } else {
        let radius = number("radius", 0.5)? * mean_scale(stored_from_prim) as f32;
        let amount = match normalized {
            // Divided by the sphere's area, 4 pi r^2, in the stage's own units.
            true => 0.25 * stage_unit.powi(2) as f32,
            false => std::f32::consts::PI * radius * radius,
        };
        (shaped(stage, prim, position, direction, notes)?, amount)
    };
    let intensity = radiance * amount;
    let is_placed = position.is_finite() && direction != Vec3::ZERO;
    if intensity == Vec3::ZERO || !intensity.is_finite() || !is_placed {
        return Ok(Found::Dark);
    }
    let name = prim.path().as_str().to_owned();
    Ok(Found::Light(Light { name, kind, intensity: LinearRgb(intensity) }))
}

/// The factor of lengths, over all directions alike.
pub fn mean_scale(transform: DAffine3) -> f64 {
    transform.matrix3.determinant().abs().cbrt()
}

/// The irradiance of a sun of radiance 1 on a surface that faces it (sizeFactor of UsdLuxLightAPI).
fn sun_size(half_angle: f32) -> f32 {
    let sine_squared = half_angle.sin().powi(2);
    let share = if half_angle <= std::f32::consts::FRAC_PI_2 { sine_squared } else { 2.0 - sine_squared };
    if half_angle == 0.0 { 1.0 } else { share * std::f32::consts::PI }
}

/// A point, or the cone that UsdLuxShapingAPI cuts out of it.
fn shaped(stage: &OpenedStage, prim: &Prim, position: Vec3, direction: Vec3, notes: &mut Notes) -> Result<LightKind> {
    let number = |name: &str, default: f32| network::parameters(stage, prim, name, [default]).map(|[value]| value);
    let range = f32::INFINITY;
    // Without the schema there is no cone; with it, half of all directions unless it says otherwise.
    let is_shaped = stage.ask(prim, prim.has_api_schema("ShapingAPI"))?;
    let degrees = number("shaping:cone:angle", if is_shaped { 90.0 } else { 180.0 })?;
    let softness = number("shaping:cone:softness", 0.0)?.clamp(LEAST_SOFTNESS, 1.0);
    if number("shaping:focus", 0.0)? > 0.0 {
        notes.add("shaping:focus of lights is left out", prim);
    }
    if stage.value(prim, "inputs:shaping:ies:file")?.is_some() {
        notes.add("IES profiles of lights are left out", prim);
    }
    if degrees >= 180.0 {
        return Ok(LightKind::Point { position, range });
    }
    if degrees > 90.0 {
        notes.add("cones of lights wider than 90 degrees from their axis are left open", prim);
        return Ok(LightKind::Point { position, range });
    }
    let outer_cone = degrees.max(0.0).to_radians().min(std::f32::consts::FRAC_PI_2);
    Ok(LightKind::Spot { position, direction, inner_cone: outer_cone * (1.0 - softness), outer_cone, range })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_irradiance_of_a_sun_is_that_of_its_disc() {
        use std::f32::consts::PI;
        assert!((sun_size(PI / 2.0) - PI).abs() < 1e-5, "half of the sky");
        assert!((sun_size(0.5_f32.to_radians()) / (PI * 0.5_f32.to_radians().sin().powi(2)) - 1.0).abs() < 1e-6);
        // Both sides of a surface: pi each.
        assert!((sun_size(PI) - 2.0 * PI).abs() < 1e-5);
        assert_eq!(sun_size(0.0), 1.0);
    }
}
