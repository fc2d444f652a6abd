//! How a job says which part of its probes it bakes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Part `index`, from 1 on, of `count` parts: `I/N`.
///
/// Neighbours in the list of probes cost about the same, so that every N-th of them is about an N-th of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String", extend("pattern" = "^[1-9][0-9]*/[1-9][0-9]*$"))]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Shard {
    /// Which part, from 1 on.
    pub fn index(self) -> u32 {
        self.index
    }

    /// How many parts there are.
    pub fn count(self) -> u32 {
        self.count
    }

    /// Whether probe number `probe`, from 0 on, belongs to the part.
    pub fn holds(self, probe: usize) -> bool {
        probe % self.count as usize == self.index as usize - 1
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index, count }),
            _ => Err(format!("'{text}' is not a part: give 'I/N' with I from 1 to N")),
        }
    }
}

impl TryFrom<String> for Shard {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        format!("{}/{}", shard.index, shard.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_probe_is_in_one_part() {
        for count in [1, 2, 7, 16] {
            let parts: Vec<Shard> = (1..=count).map(|index| format!("{index}/{count}").parse().unwrap()).collect();
            for probe in 0..40 {
                assert_eq!(parts.iter().filter(|part| part.holds(probe)).count(), 1);
            }
        }
    }

    #[test]
    fn malformed_parts_are_errors() {
        for text in ["", "1", "0/2", "3/2", "1/0", "-1/2", "1/2/3", "a/b", "1/99999999999"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
        assert_eq!(String::from("2/7".parse::<Shard>().unwrap()), "2/7");
    }
}
