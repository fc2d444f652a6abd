//! The Pareto front: what no other beats in both time and error.

/// Shares of a time or an error that decide nothing: times of the same work differ by as much from run to run.
pub const TIE: f64 = 0.05;

/// Whether each of `points`, a time and an error, is on the front: no other one is at least as good in both and better in one
/// by more than [`TIE`].
pub fn front(points: &[[f64; 2]]) -> Vec<bool> {
    let beats = |a: &[f64; 2], b: &[f64; 2]| {
        a[0] <= b[0] && a[1] <= b[1] && (a[0] < b[0] * (1.0 - TIE) || a[1] < b[1] * (1.0 - TIE))
    };
    points.iter().map(|point| !points.iter().any(|other| beats(other, point))).collect()
}
