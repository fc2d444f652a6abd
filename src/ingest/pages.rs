//! Memory for what files are decoded into.

use bytemuck::Zeroable;

/// Bytes of a large page on x86-64 and mostly on ARM; a multiple of the small ones everywhere.
#[cfg(target_os = "linux")]
const LARGE: usize = 2 << 20;

/// `count` zeros whose memory the system hands out when it is first written to, and then in large pages where it can: a
/// load of a gigabyte in pages of 4 KiB spends a fifth of its time being handed them.
pub(super) fn untouched<T: Zeroable>(count: usize) -> Vec<T> {
    let mut values = bytemuck::zeroed_vec(count);
    prefer_large_pages(&mut values);
    values
}

#[cfg(target_os = "linux")]
fn prefer_large_pages<T>(values: &mut [T]) {
    let range = values.as_mut_ptr_range();
    let (start, end) = (range.start.addr().next_multiple_of(LARGE), range.end.addr() / LARGE * LARGE);
    if start < end {
        let first = range.start.cast::<libc::c_void>().with_addr(start);
        // Where the system refuses, the pages are small.
        // SAFETY: the advice changes how memory is backed and not what it holds, and all of `start..end` lies in `values`.
        let _ = unsafe { libc::madvise(first, end - start, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn prefer_large_pages<T>(_: &mut [T]) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_below_within_and_above_large_pages_is_zero_and_writable() {
        for count in [0, 1, 4096, (1 << 19) + 1, 3 << 19] {
            let mut values = untouched::<f32>(count);
            assert!(values.len() == count && values.iter().all(|&value| value == 0.0));
            values.fill(1.0);
            assert!(values.iter().all(|&value| value == 1.0));
        }
    }
}
