//! What fits under `--max-memory`: known from the inputs' headers before they are read, and from the scene before it is
//! traced.

use bytesize::ByteSize;

use super::plan::Loaded;
use crate::bvh::{Bvh, WideNode};
use crate::ingest;
use crate::job::Job;
use crate::scene::Splats;
use crate::{Error, Result};

/// Bytes per texel of a probe under way: its cubemap, the tiles' rays, and the mips and files made from it. Measured on faces
/// of 1024 and 2048 texels: 47 with a strip alone, 120 with all kinds of files.
const TEXEL_BYTES: u64 = 120;

const FLAG: &str = "--max-memory";

/// Refuses inputs whose Gaussians, with the tree while it is built, are larger than the job allows.
pub(super) fn check_inputs(job: &Job) -> Result<()> {
    let Some(ceiling) = job.max_memory else { return Ok(()) };
    let (count, degree) = ingest::count_gaussians(&job.splats, &job.meshes)?;
    let needed = ByteSize(count as u64 * (Splats::bytes_each(degree) + Bvh::BUILD_BYTES_PER_GAUSSIAN));
    if needed <= ceiling {
        return Ok(());
    }
    let why = format!(
        "{count} Gaussians of SH degree {degree} take {needed:.1} with their tree, and {ceiling:.1} are allowed: allow more, or \
         give a coarser level of detail, a decimated file or one of a lower degree"
    );
    Err(Error::request(FLAG, why))
}

/// How many probes may be under way beside the scene; `None` without a limit. Fails when not even one fits.
pub(super) fn probes_at_a_time(job: &Job, Loaded { scene, bvh, .. }: &Loaded) -> Result<Option<usize>> {
    let Some(ceiling) = job.max_memory else { return Ok(None) };
    let splats = scene.splats.len() as u64 * Splats::bytes_each(scene.splats.sh_degree);
    let tree = size_of_val::<[WideNode]>(&bvh.nodes) as u64;
    let taken = ByteSize(splats + tree + scene.meshes.bytes() as u64);
    let probe = ByteSize(6 * u64::from(job.face_size).pow(2) * TEXEL_BYTES);
    match ceiling.0.saturating_sub(taken.0) / probe.0 {
        0 => {
            let why = format!(
                "the scene takes {taken:.1} and a probe of {} texels {probe:.1}, and {ceiling:.1} are allowed: allow more, or \
                 bake smaller faces",
                job.face_size
            );
            Err(Error::request(FLAG, why))
        }
        probes => Ok(Some(usize::try_from(probes).unwrap_or(usize::MAX))),
    }
}
