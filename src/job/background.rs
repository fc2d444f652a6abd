//! How a job says what rays that leave the scene see.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::parse_numbers;

/// What rays that leave the scene see: a linear colour, or an image of all directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Background {
    /// Linear red, green, blue radiance, the same everywhere.
    Colour(#[schemars(inner(range(min = 0.0)))] [f32; 3]),
    /// An .exr or .hdr file, by latitude and longitude, twice as wide as high: +Y at the top, +Z in the middle, +X a quarter
    /// to its left, as OpenEXR has it. A relative path is relative to the job file.
    Map(PathBuf),
}

impl Default for Background {
    fn default() -> Self {
        Self::Colour([0.0; 3])
    }
}

impl From<[f32; 3]> for Background {
    fn from(colour: [f32; 3]) -> Self {
        Self::Colour(colour)
    }
}

impl std::str::FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let extension = std::path::Path::new(text).extension().unwrap_or_default().to_ascii_lowercase();
        if extension == "exr" || extension == "hdr" {
            return Ok(Self::Map(text.into()));
        }
        let colour = parse_numbers::<3>(text).map_err(|why| format!("{why}, and not an .exr or .hdr file"))?;
        Ok(Self::Colour(colour.map(|value| value as f32)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_background_is_a_colour_or_a_file_in_both_forms() {
        let colour = Background::Colour([0.5, 1.0, 2.0]);
        let map = Background::Map("sky.EXR".into());
        assert_eq!("0.5,1,2".parse(), Ok(colour.clone()));
        assert_eq!("sky.EXR".parse(), Ok(map.clone()));
        assert_eq!(serde_json::from_str::<Background>("[0.5, 1, 2]").unwrap(), colour);
        assert_eq!(serde_json::from_str::<Background>("\"sky.EXR\"").unwrap(), map);
        assert!("sky.png".parse::<Background>().is_err());
    }
}
