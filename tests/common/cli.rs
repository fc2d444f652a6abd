//! Runs the command line tool and looks at what it left.
#![allow(dead_code)] // each test binary uses its part

use std::path::Path;
use std::process::{Command, Output};

/// Runs a line of words without quotes in `folder`.
pub fn splatprobe(folder: &Path, line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_splatprobe")).args(line.split_whitespace()).current_dir(folder).output().unwrap()
}

/// Every file under `folder` with its content.
pub fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            files.extend(contents(&path).into_iter().map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)));
        } else {
            files.push((name, std::fs::read(&path).unwrap()));
        }
    }
    files.sort();
    files
}
