//! `splatprobe cache`: how much a cache holds, and less of it.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use serde_json::json;
use splatprobe::cache::Store;
use splatprobe::{Error, Result};

/// Look at a folder of results that `bake --cache` made, or make it smaller. Prints JSON.
#[derive(Debug, Args)]
pub struct Cache {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Print how many entries there are and how many bytes they take.
    Stats {
        /// The folder.
        cache: PathBuf,
    },
    /// Remove what was not used for long, and then what was used longest ago until the rest fits. Prints what was removed.
    Prune {
        /// The folder.
        cache: PathBuf,
        /// Most bytes to keep; K, M, G and T stand for powers of 1024.
        #[arg(long, value_name = "SIZE", value_parser = parse_size, required_unless_present = "max_age")]
        max_size: Option<u64>,
        /// Longest time without use, in days.
        #[arg(long, value_name = "DAYS", value_parser = parse_days)]
        max_age: Option<Duration>,
    },
}

impl Cache {
    pub fn run(self) -> Result<String> {
        let statistics = match self.command {
            Command::Stats { cache } => opened(cache)?.statistics()?,
            Command::Prune { cache, max_size, max_age } => opened(cache)?.prune(max_size, max_age)?,
        };
        Ok(super::json(&json!(statistics)))
    }
}

/// A folder that is not there is most likely a slip of the finger.
fn opened(cache: PathBuf) -> Result<Store> {
    match cache.is_dir() {
        true => Ok(Store::new(cache)),
        false => Err(Error::read(cache, std::io::Error::other("not a folder"))),
    }
}

fn parse_size(text: &str) -> std::result::Result<u64, String> {
    let digits = text.trim_end_matches(['K', 'M', 'G', 'T']);
    let unit = match &text[digits.len()..] {
        "" => Some(1),
        "K" => Some(1 << 10),
        "M" => Some(1 << 20),
        "G" => Some(1 << 30),
        "T" => Some(1_u64 << 40),
        _ => None,
    };
    let size = digits.parse::<u64>().ok().zip(unit).and_then(|(number, unit)| number.checked_mul(unit));
    size.ok_or_else(|| format!("'{text}' is not a size: give bytes, or a number with K, M, G or T"))
}

fn parse_days(text: &str) -> std::result::Result<Duration, String> {
    let days = text.parse::<f64>().ok();
    let duration = days.and_then(|days| Duration::try_from_secs_f64(days * 86_400.0).ok());
    duration.ok_or_else(|| format!("'{text}' is not a number of days"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units_of_1024() {
        assert_eq!(parse_size("0"), Ok(0));
        assert_eq!(parse_size("3K"), Ok(3072));
        assert_eq!(parse_size("2G"), Ok(2 << 30));
        for text in ["", "G", "-1", "1KK", "1.5G", "99999999999T"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
        assert!(parse_days("-1").is_err() && parse_days("nan").is_err());
        assert_eq!(parse_days("0.5"), Ok(Duration::from_secs(43_200)));
    }
}
