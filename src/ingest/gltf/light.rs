//! KHR_lights_punctual: lights under their nodes.

use glam::{DAffine3, DVec3, Vec3};
use gltf::json::Node;
use serde::Deserialize;
use serde_json::Value;

use super::container::{Asset, place};
use crate::Result;
use crate::scene::light::LightKind;
use crate::scene::{Light, LinearRgb};

const EXTENSION: &str = "KHR_lights_punctual";

/// A light as the extension writes it, with its defaults.
#[derive(Deserialize)]
#[serde(default)]
struct LightJson {
    name: Option<String>,
    color: [f32; 3],
    intensity: f32,
    #[serde(rename = "type")]
    kind: String,
    range: Option<f32>,
    spot: Spot,
}

impl Default for LightJson {
    fn default() -> Self {
        Self { name: None, color: [1.0; 3], intensity: 1.0, kind: String::new(), range: None, spot: Spot::default() }
    }
}

#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Spot {
    inner_cone_angle: f32,
    outer_cone_angle: f32,
}

impl Default for Spot {
    fn default() -> Self {
        Self { inner_cone_angle: 0.0, outer_cone_angle: std::f32::consts::FRAC_PI_4 }
    }
}

/// The light of a node, if it has one. `None` inside: one that gives no light, because its intensity is 0 or its node
/// leaves it no place or direction.
///
/// `stored_from_node` leads to coordinates relative to the scene's origin. It moves and turns a light and changes nothing
/// else about it.
pub fn of_node(asset: &Asset, node: &Node, stored_from_node: DAffine3, here: &str) -> Result<Option<Option<Light>>> {
    let extension = node.extensions.as_ref().and_then(|all| all.others.get(EXTENSION));
    let Some(extension) = extension else { return Ok(None) };
    let index = extension.get("light").and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
    let index = index.ok_or_else(|| asset.invalid(here, format!("{EXTENSION} has no light")))?;
    let lights = asset.root.extensions.as_ref().and_then(|all| all.others.get(EXTENSION)?.get("lights"));
    let json = lights.and_then(|lights| lights.get(index));
    let json = json.ok_or_else(|| asset.invalid(here, format!("{EXTENSION}: light {index} is out of range")))?;
    let name = json.get("name").and_then(Value::as_str);
    let there = place(&format!("extensions/{EXTENSION}/lights"), index, name);
    let light = LightJson::deserialize(json).map_err(|e| asset.invalid(&there, e.to_string()))?;
    light.placed(asset, stored_from_node, &there).map(Some)
}

impl LightJson {
    fn placed(self, asset: &Asset, stored_from_node: DAffine3, there: &str) -> Result<Option<Light>> {
        let invalid = |what: String| asset.invalid(there, what);
        let intensity = Vec3::from(self.color) * self.intensity;
        let factors = self.color.into_iter().chain([self.intensity]).chain(intensity.to_array());
        if !factors.clone().all(|factor| factor.is_finite() && factor >= 0.0) {
            return Err(invalid("its color and intensity must be finite and not negative".into()));
        }
        let range = self.range.unwrap_or(f32::INFINITY);
        if !(range > 0.0) {
            return Err(invalid(format!("its range is {range}; it must be above 0")));
        }
        let position = stored_from_node.translation.as_vec3();
        let direction = stored_from_node.transform_vector3(DVec3::NEG_Z).normalize_or_zero().as_vec3();
        let kind = match self.kind.as_str() {
            "directional" => LightKind::Directional { direction },
            "point" => LightKind::Point { position, range },
            "spot" => {
                let (inner_cone, outer_cone) = (self.spot.inner_cone_angle, self.spot.outer_cone_angle);
                // The largest f32 angle may lie a rounding above pi / 2.
                if !(0.0 <= inner_cone && inner_cone < outer_cone && outer_cone <= std::f32::consts::FRAC_PI_2 + 1e-6) {
                    return Err(invalid(format!(
                        "its cones are {inner_cone} and {outer_cone}; the inner must be below the outer, and that at \
                         most pi / 2"
                    )));
                }
                LightKind::Spot { position, direction, inner_cone, outer_cone, range }
            }
            other => return Err(asset.unsupported(format!("{there}: a light of type '{other}'"))),
        };
        let shines = intensity != Vec3::ZERO
            && match kind {
                LightKind::Directional { direction } => direction != Vec3::ZERO,
                LightKind::Point { position, .. } => position.is_finite(),
                LightKind::Spot { position, direction, .. } => position.is_finite() && direction != Vec3::ZERO,
            };
        let name = self.name.unwrap_or_default();
        Ok(shines.then_some(Light { name, kind, intensity: LinearRgb(intensity) }))
    }
}
