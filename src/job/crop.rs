//! The part of a splat file that a bake uses.

use glam::DVec3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::parse_numbers;
use crate::scene::bounds::Bounds;

/// A region that Gaussians are kept in, by their means, in world metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "camelCase")]
pub enum Crop {
    /// A box, faces included: x0, y0, z0, x1, y1, z1.
    Box([f64; 6]),
    /// A ball, surface included: x, y, z of its centre, then its radius.
    Sphere([f64; 4]),
}

impl Crop {
    /// Whether a point, in world metres, lies inside. One that is not a number does not.
    pub fn contains(&self, world: DVec3) -> bool {
        match *self {
            Self::Box([x0, y0, z0, x1, y1, z1]) => {
                world.cmpge(DVec3::new(x0, y0, z0)).all() && world.cmple(DVec3::new(x1, y1, z1)).all()
            }
            Self::Sphere([x, y, z, radius]) => world.distance_squared(DVec3::new(x, y, z)) <= radius * radius,
        }
    }

    /// Whether a point of the box, in world metres, may lie inside: rounding of its corners does not decide.
    pub fn touches(&self, world: &Bounds) -> bool {
        let margin = 1e-9 * (1.0 + world.min.abs().max(world.max.abs()).max_element());
        let (min, max) = (world.min - margin, world.max + margin);
        match *self {
            Self::Box([x0, y0, z0, x1, y1, z1]) => {
                min.cmple(DVec3::new(x1, y1, z1)).all() && max.cmpge(DVec3::new(x0, y0, z0)).all()
            }
            Self::Sphere([x, y, z, radius]) => {
                let centre = DVec3::new(x, y, z);
                centre.distance_squared(centre.clamp(min, max)) <= radius * radius
            }
        }
    }
}

/// The command line's form: `box:x0,y0,z0,x1,y1,z1` or `sphere:x,y,z,r`, in metres.
impl std::str::FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("box", corners)) => parse_numbers(corners).map(Self::Box),
            Some(("sphere", ball)) => parse_numbers(ball).map(Self::Sphere),
            _ => Err(format!("'{text}' is not a region: give 'box:x0,y0,z0,x1,y1,z1' or 'sphere:x,y,z,r'")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_holds_its_faces_and_a_sphere_its_surface() {
        let region: Crop = "box:-1,0,2,1,0.5,3".parse().unwrap();
        assert!(region.contains(DVec3::new(1.0, 0.0, 2.5)) && region.contains(DVec3::new(-1.0, 0.5, 3.0)));
        assert!(!region.contains(DVec3::new(0.0, 0.6, 2.5)) && !region.contains(DVec3::new(0.0, f64::NAN, 2.5)));
        let ball: Crop = "sphere:1,2,3,0.5".parse().unwrap();
        assert!(ball.contains(DVec3::new(1.5, 2.0, 3.0)) && !ball.contains(DVec3::new(1.5, 2.1, 3.0)));
        assert!(!ball.contains(DVec3::NAN));
    }

    #[test]
    fn a_region_touches_the_boxes_that_share_a_point_with_it() {
        let bounds = |min: [f64; 3], max: [f64; 3]| Bounds { min: min.into(), max: max.into() };
        let region: Crop = "box:0,0,0,1,1,1".parse().unwrap();
        assert!(region.touches(&bounds([-1.0; 3], [2.0; 3])) && region.touches(&bounds([1.0, -1.0, 0.5], [2.0; 3])));
        assert!(!region.touches(&bounds([1.1, -1.0, 0.5], [2.0; 3])));
        let ball: Crop = "sphere:0,0,0,1".parse().unwrap();
        assert!(ball.touches(&bounds([-2.0; 3], [2.0; 3])) && ball.touches(&bounds([0.5; 3], [2.0; 3])));
        assert!(!ball.touches(&bounds([0.6; 3], [2.0; 3])));
    }

    #[test]
    fn malformed_regions_are_errors() {
        for text in ["", "box", "box:1,2,3", "sphere:1,2,3", "cone:1,2,3,4", "sphere:0,0,0,nan", "1,2,3,4"] {
            assert!(text.parse::<Crop>().is_err(), "{text}");
        }
    }
}
