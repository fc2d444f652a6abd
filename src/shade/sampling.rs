//! Points of a Sobol sequence, shuffled and Owen-scrambled by hashes (Burley 2020), four dimensions at a time.
//!
//! A sequence depends on its seed and nothing else, so that what is computed with it does not depend on threads. The first
//! 2^n points of each set of four dimensions are spread evenly for every n; sets are independent of each other.

/// Joe and Kuo's direction numbers (new-joe-kuo-6.21201) of the second to fourth dimension: degree, coefficients, initial m.
const INITIAL: [(usize, u32, [u32; 3]); 3] = [(1, 0, [1, 0, 0]), (2, 1, [1, 3, 0]), (3, 1, [1, 3, 1])];

const DIRECTIONS: [[u32; 32]; 4] = directions();

const fn directions() -> [[u32; 32]; 4] {
    let mut directions = [[0; 32]; 4];
    let mut bit = 0;
    while bit < 32 {
        directions[0][bit] = 1 << (31 - bit);
        bit += 1;
    }
    let mut dimension = 1;
    while dimension < 4 {
        let (degree, coefficients, m) = INITIAL[dimension - 1];
        let mut bit = 0;
        while bit < 32 {
            directions[dimension][bit] = if bit < degree {
                m[bit] << (31 - bit)
            } else {
                let earlier = directions[dimension][bit - degree];
                let mut direction = earlier ^ (earlier >> degree);
                let mut k = 1;
                while k < degree {
                    if coefficients >> (degree - 1 - k) & 1 == 1 {
                        direction ^= directions[dimension][bit - k];
                    }
                    k += 1;
                }
                direction
            };
            bit += 1;
        }
        dimension += 1;
    }
    directions
}

/// The `i`-th of `count` unit directions spread evenly over the sphere (Fibonacci lattice: equal steps in height, a
/// golden section of a turn each).
pub fn fibonacci(i: usize, count: usize) -> glam::DVec3 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let y = 1.0 - (2 * i + 1) as f64 / count as f64;
    let (sin, cos) = (std::f64::consts::TAU * (i as f64 * GOLDEN).fract()).sin_cos();
    let radius = (1.0 - y * y).sqrt();
    glam::DVec3::new(radius * cos, y, radius * sin)
}

/// One point of a sequence, whose coordinates are asked for four at a time.
#[derive(Debug, Clone)]
pub struct Sampler {
    index: u32,
    seed: u32,
    set: u32,
}

impl Sampler {
    /// Point `index` of the sequence of `seed`.
    pub fn new(seed: u32, index: u32) -> Self {
        Self { index, seed, set: 0 }
    }

    /// The point's next four coordinates, in [0, 1).
    pub fn next_four(&mut self) -> [f32; 4] {
        let seed = hash(self.seed ^ hash(self.set));
        self.set += 1;
        let index = scramble(self.index, seed);
        std::array::from_fn(|dimension| {
            let mut coordinate = 0;
            for (bit, direction) in DIRECTIONS[dimension].iter().enumerate() {
                coordinate ^= direction * (index >> bit & 1);
            }
            let scrambled = scramble(coordinate, hash(seed.wrapping_add(dimension as u32 + 1)));
            // The upper 24 bits: more would round up to 1.
            (scrambled >> 8) as f32 / (1 << 24) as f32
        })
    }
}

/// Owen's nested uniform scrambling in base 2, by Laine and Karras's hash (2011).
fn scramble(value: u32, seed: u32) -> u32 {
    let mut x = value.reverse_bits().wrapping_add(seed);
    for factor in [0x6c50_b47c, 0xb82f_1e52, 0xc7af_e638, 0x8d22_f6e6_u32] {
        x ^= x.wrapping_mul(factor);
    }
    x.reverse_bits()
}

/// Mixes all bits of `x` (Wellons's lowbias32).
pub fn hash(mut x: u32) -> u32 {
    x = (x ^ x >> 16).wrapping_mul(0x7feb_352d);
    x = (x ^ x >> 15).wrapping_mul(0x846c_a68b);
    x ^ x >> 16
}

/// The hash of several words, in their order.
pub fn hash_all(words: impl IntoIterator<Item = u32>) -> u32 {
    words.into_iter().fold(0, |state, word| hash(state.wrapping_mul(0x9e37_79b9) ^ hash(word)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_is_joe_and_kuos() {
        // The unscrambled points 1 to 4 of their example program, times 8.
        let sobol =
            |index: u32, d: usize| (0..32).fold(0, |x, bit| x ^ (DIRECTIONS[d][bit] * (index >> bit & 1))) >> 29;
        let gray = |i: u32| i ^ i >> 1;
        let points: Vec<[u32; 3]> = (1..5).map(|i| [0, 1, 2].map(|d| sobol(gray(i), d))).collect();
        assert_eq!(points, [[4, 4, 4], [6, 2, 2], [2, 6, 6], [3, 3, 5]]);
    }

    #[test]
    fn every_power_of_two_is_stratified_in_one_and_two_dimensions() {
        for seed in [0, 1, 0xdead_beef] {
            for log in [2, 4, 8] {
                let count = 1u32 << log;
                let points: Vec<[f32; 4]> = (0..count).map(|i| Sampler::new(seed, i).next_four()).collect();
                for d in 0..4 {
                    let mut strata: Vec<u32> = points.iter().map(|p| (p[d] * count as f32) as u32).collect();
                    strata.sort_unstable();
                    assert!(strata.iter().copied().eq(0..count), "dimension {d} of {count}");
                }
                let edge = 1u32 << (log / 2);
                let cell = |p: &[f32; 4]| (p[0] * edge as f32) as u32 * edge + (p[1] * edge as f32) as u32;
                let mut cells: Vec<u32> = points.iter().map(cell).collect();
                cells.sort_unstable();
                assert!(cells.into_iter().eq(0..count), "{count}");
            }
        }
    }

    #[test]
    fn sets_and_seeds_are_independent() {
        // The mean product of centred coordinates is 1/12 for equal ones and 0 for independent ones.
        let mean = |f: &dyn Fn(u32) -> [f32; 2]| {
            let sum: f32 = (0..4096).map(|i| f(i).map(|x| x - 0.5).into_iter().product::<f32>()).sum();
            sum / 4096.0
        };
        let across_sets = mean(&|i| {
            let mut sampler = Sampler::new(3, i);
            [sampler.next_four()[0], sampler.next_four()[0]]
        });
        let across_seeds = mean(&|i| [Sampler::new(3, i).next_four()[0], Sampler::new(4, i).next_four()[0]]);
        assert!(across_sets.abs() < 0.006 && across_seeds.abs() < 0.006, "{across_sets} {across_seeds}");
    }
}
