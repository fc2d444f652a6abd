//! How a job says what a pixel covers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How Gaussians are widened so that fine ones do not alias: `none`, `pixel`, or `train:` and a focal length in pixels.
#[derive(Debug, Default, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String", extend("pattern" = r"^(none|pixel|train:[0-9]*\.?[0-9]+([eE][+-]?[0-9]+)?)$"))]
pub enum Footprint {
    /// Not at all: each ray is a line. The default.
    #[default]
    None,
    /// By a share of a pixel, with what each sends kept.
    Pixel,
    /// As 3DGS widens them while it trains on images of this focal length in pixels, with their opacity kept.
    Train(f64),
}

/// Shorter focal lengths, in pixels, would widen a Gaussian to more than half its distance.
pub(super) const MIN_FOCAL: f64 = 1.0;

impl std::str::FromStr for Footprint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("train:").and_then(|focal| focal.parse::<f64>().ok())) {
            ("none", _) => Ok(Self::None),
            ("pixel", _) => Ok(Self::Pixel),
            (_, Some(focal)) => Ok(Self::Train(focal)),
            _ => Err(format!(
                "'{text}' is not a footprint: give 'none', 'pixel' or 'train:1200', a focal length in pixels"
            )),
        }
    }
}

impl TryFrom<String> for Footprint {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Footprint> for String {
    fn from(footprint: Footprint) -> Self {
        match footprint {
            Footprint::None => "none".into(),
            Footprint::Pixel => "pixel".into(),
            Footprint::Train(focal) => format!("train:{focal}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_footprint_is_read_as_it_is_written() {
        for text in ["none", "pixel", "train:1200", "train:812.5"] {
            assert_eq!(String::from(text.parse::<Footprint>().unwrap()), text);
        }
        for text in ["", "None", "train", "train:", "train:wide", "pixel:2"] {
            assert!(text.parse::<Footprint>().is_err(), "{text}");
        }
    }
}
