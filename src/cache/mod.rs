//! What earlier bakes found out, by the hash of all that it depends on: content-addressed, so that it is never out of date.
//!
//! A [`Key`] is the BLAKE3 hash of everything that decides a result; a [`Store`] is a folder with one file per key, which
//! many processes, checkouts and machines may share. An entry that is damaged, cut off or of another program is no entry.
//! [`Digests`] keep the hashes of large inputs, so that an unchanged file of gigabytes is known without being read.

mod bundle;
mod digests;
mod store;

use serde::{Deserialize, Serialize};

use crate::trace::Level;

pub use bundle::Bundle;
pub use digests::{Digest, Digests};
pub use store::{CacheStatistics, Store};

/// Raise it with every change that alters a pixel, a number or a file of any bake: results of other versions are then not
/// taken from a cache any more.
pub const KERNEL_VERSION: u32 = 5;

/// The hash of all that a result depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Key([u8; 32]);

impl Key {
    /// The key of the kind of result that `kind` names, which depends on the program and on `content` alone.
    ///
    /// JSON tells the parts of `content` apart, whatever they hold. Numbers that are not finite are all the same in it.
    pub fn of(kind: &str, content: &impl Serialize) -> Self {
        let mut hasher = blake3::Hasher::new();
        if serde_json::to_writer(&mut hasher, &(Program::here(), kind, content)).is_err() {
            // A path that is no text: what it decides is like nothing else.
            hasher.update(format!("{:?} {}", std::time::SystemTime::now(), std::process::id()).as_bytes());
        }
        Self(*hasher.finalize().as_bytes())
    }

    fn hex(&self) -> String {
        blake3::Hash::from_bytes(self.0).to_hex().to_string()
    }
}

/// What else decides the bytes of a result: instruction levels round differently, and so do the mathematical functions of
/// platforms.
#[derive(Serialize)]
struct Program {
    version: &'static str,
    kernels: u32,
    level: &'static str,
    architecture: &'static str,
    system: &'static str,
}

impl Program {
    fn here() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            kernels: KERNEL_VERSION,
            level: Level::best().name(),
            architecture: std::env::consts::ARCH,
            system: std::env::consts::OS,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_differ_by_kind_and_content_and_by_where_parts_end() {
        let keys = [
            Key::of("a", &("x", "yz")),
            Key::of("a", &("xy", "z")),
            Key::of("b", &("x", "yz")),
            Key::of("a", &("x", "yz", 0)),
            Key::of("a", &("x\",\"yz")),
        ];
        assert_eq!(keys[0], Key::of("a", &("x", "yz")));
        for (i, key) in keys.iter().enumerate() {
            assert!(!keys[..i].contains(key));
        }
    }
}
