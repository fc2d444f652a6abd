//! The transform operations of a prim (UsdGeomXformable), in the order that xformOpOrder gives.

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};
use openusd::sdf::Value;
use openusd::usd::Prim;

use super::OpenedStage;
use super::values::numbers;
use crate::error::Result;

/// Parent from `prim`, and whether the prim leaves its parent's transform out.
///
/// The first operation is the outermost. USD multiplies row vectors from the left; its matrices read column by column are
/// those of column vectors.
pub fn local(stage: &OpenedStage, prim: &Prim) -> Result<(DAffine3, bool)> {
    let order = match stage.value(prim, "xformOpOrder")? {
        None => return Ok((DAffine3::IDENTITY, false)),
        Some(Value::TokenVec(order)) => order,
        Some(_) => return Err(stage.invalid(prim, "xformOpOrder is not a list of tokens")),
    };
    let mut parent_from_prim = DAffine3::IDENTITY;
    let mut resets = false;
    for operation in &order {
        let operation = operation.as_ref();
        if operation == "!resetXformStack!" {
            (parent_from_prim, resets) = (DAffine3::IDENTITY, true);
            continue;
        }
        let (name, inverted) = match operation.strip_prefix("!invert!") {
            Some(name) => (name, true),
            None => (operation, false),
        };
        let kind = name.strip_prefix("xformOp:").and_then(|rest| rest.split(':').next()).unwrap_or_default();
        // An operation without a value moves nothing.
        let Some(value) = stage.value(prim, name)? else { continue };
        let matrix = numbers(&value).and_then(|values| matrix_of(kind, &values));
        let matrix = matrix.ok_or_else(|| stage.invalid(prim, format!("{name} is no transform that USD knows")))?;
        parent_from_prim *= if inverted { matrix.inverse() } else { matrix };
    }
    Ok((parent_from_prim, resets))
}

/// The operation `kind` with `values`; angles are degrees, quaternions w x y z.
fn matrix_of(kind: &str, values: &[f64]) -> Option<DAffine3> {
    let about = |axis: char, degrees: f64| match axis {
        'X' => Some(DQuat::from_rotation_x(degrees.to_radians())),
        'Y' => Some(DQuat::from_rotation_y(degrees.to_radians())),
        'Z' => Some(DQuat::from_rotation_z(degrees.to_radians())),
        _ => None,
    };
    Some(match (kind, values) {
        ("translate", &[x, y, z]) => DAffine3::from_translation(DVec3::new(x, y, z)),
        ("translateX", &[x]) => DAffine3::from_translation(DVec3::X * x),
        ("translateY", &[y]) => DAffine3::from_translation(DVec3::Y * y),
        ("translateZ", &[z]) => DAffine3::from_translation(DVec3::Z * z),
        ("scale", &[x, y, z]) => DAffine3::from_scale(DVec3::new(x, y, z)),
        ("scaleX", &[x]) => DAffine3::from_scale(DVec3::new(x, 1.0, 1.0)),
        ("scaleY", &[y]) => DAffine3::from_scale(DVec3::new(1.0, y, 1.0)),
        ("scaleZ", &[z]) => DAffine3::from_scale(DVec3::new(1.0, 1.0, z)),
        ("orient", &[w, x, y, z]) => {
            let rotation = DQuat::from_xyzw(x, y, z, w);
            DAffine3::from_quat(if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY })
        }
        ("transform", values) => {
            let matrix = DMat4::from_cols_array(values.try_into().ok()?);
            if (matrix.row(3) - DVec4::W).abs().max_element() > 1e-5 {
                return None;
            }
            DAffine3::from_mat4(matrix)
        }
        // Three letters name the order of turning, the first letter's first; the angles stand in the order x y z.
        (kind, values) => {
            let axes = kind.strip_prefix("rotate")?;
            let rotation = match (axes.len(), values) {
                (1, &[degrees]) => about(axes.chars().next()?, degrees)?,
                (3, &[x, y, z]) => axes.chars().try_fold(DQuat::IDENTITY, |turned, axis| {
                    let degrees = match axis {
                        'X' => x,
                        'Y' => y,
                        _ => z,
                    };
                    Some(about(axis, degrees)? * turned)
                })?,
                _ => return None,
            };
            DAffine3::from_quat(rotation)
        }
    })
}
