//! What benches are asked that look at faces of several sizes from one place.

use glam::DVec3;

use crate::scene::eye;

pub struct Arguments {
    /// Of the generated interior, without a file of splats.
    pub gaussians: usize,
    pub splats: Option<String>,
    /// In metres, world space.
    pub probe: DVec3,
    /// Texels along an edge of a face.
    pub sizes: Vec<u32>,
}

impl Arguments {
    /// Those of the command line; the others as given.
    pub fn parse(gaussians: usize, sizes: &[u32]) -> Self {
        let mut arguments = Self { gaussians, splats: None, probe: eye(), sizes: sizes.to_vec() };
        let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
        while let Some(word) = words.next() {
            let value = words.next().unwrap_or_else(|| panic!("{word} needs a value"));
            match word.as_str() {
                "--gaussians" => arguments.gaussians = value.parse().expect("a number of Gaussians"),
                "--splats" => arguments.splats = Some(value),
                "--probe" => {
                    let metres: Vec<f64> = value.split(',').map(|x| x.parse().expect("metres")).collect();
                    arguments.probe = DVec3::from_slice(&metres);
                }
                "--sizes" => arguments.sizes = value.split(',').map(|size| size.parse().expect("texels")).collect(),
                _ => panic!("{word} is not an argument of this bench"),
            }
        }
        arguments
    }
}
