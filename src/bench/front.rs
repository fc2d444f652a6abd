//! The Pareto front: what no other beats in both time and error.

/// Whether each of `points`, a time and an error, is on the front: no other one is better in one and at least as good in the
/// other. Of equal points all are.
pub fn front(points: &[[f64; 2]]) -> Vec<bool> {
    let beats = |a: &[f64; 2], b: &[f64; 2]| a[0] <= b[0] && a[1] <= b[1] && a != b;
    points.iter().map(|point| !points.iter().any(|other| beats(other, point))).collect()
}
