//! How a surface scatters light: glTF 2.0's metallic-roughness model and its extensions.

mod parameters;

pub use parameters::Parameters;
