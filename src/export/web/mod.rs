//! What the exporters for web engines share with the preview.

/// Which probes count at a position: an ES module.
pub const PROBES_JS: &str = include_str!("probes.js");

/// How a probe is looked up: GLSL for WebGL 2.
pub const PROBES_GLSL: &str = include_str!("probes.glsl");
