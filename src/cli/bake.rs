//! `splatprobe bake`: a job from its file and from flags, baked.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use bytesize::ByteSize;
use clap::Args;
use splatprobe::job::{
    Background, Crop, Footprint, Frame, HdrEncoding, Job, MeshInput, MissingTexture, Order, OutputKind, Pixel, Preset,
    ProgressStyle, RoughnessCurve, ShDirection, Shard, SplatInput, Surface, Tonemapper, Tracer, Transform,
    parse_numbers,
};
use splatprobe::scene::SplatEncoding;
use splatprobe::{Error, Result, pipeline};

use super::progress;

/// Bake probes: cubemaps, a contact sheet and a manifest, whose path is printed.
///
/// The job file holds the same settings as the flags (see `splatprobe schema job`); a flag overrides the job file.
///
/// Flags that describe an input (--splat-frame, --splat-transform, --splat-encoding, --lod, --crop, --min-opacity;
/// --mesh-transform, --mesh-scene, --variant, --missing-texture) belong to the inputs in order, the first to the first; given once, they belong to all.
///
/// A file that holds both splats and meshes brings both, whichever of --splats and --mesh names it; named by both, each
/// kind stands where the flags of its kind say.
///
/// A transform is any of t=X,Y,Z (metres), euler=X,Y,Z (degrees about the fixed X, then Y, then Z axis) or r=X,Y,Z,W (unit
/// quaternion), and s=K or s=X,Y,Z, separated by spaces; scale is applied first: --mesh-transform "t=1,0,-2 euler=0,90,0".
#[derive(Debug, Args)]
pub struct Bake {
    /// Job file; relative paths in it are relative to its folder.
    job: Option<PathBuf>,

    /// Splat file; repeat it for more. Replaces the job file's.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    splats: Vec<PathBuf>,
    /// What the splat file's +X +Y +Z point at: letters of r/l u/d f/b (glTF: rub, 3DGS: rdf), or raw [default: the
    /// format's].
    #[arg(long, value_name = "XYZ", help_heading = "Inputs")]
    splat_frame: Vec<Frame>,
    /// World from canonical splat coordinates [default: identity].
    #[arg(long, value_name = "TRS", help_heading = "Inputs")]
    splat_transform: Vec<Transform>,
    /// What the splats' blended colours mean [default: what the format declares, else srgb-display].
    #[arg(long, value_name = "ENCODING", help_heading = "Inputs")]
    splat_encoding: Vec<SplatEncoding>,
    /// Level of detail of a splat file that has several (streamed SOG); 0 is the finest [default: 0].
    #[arg(long, value_name = "N", help_heading = "Inputs")]
    lod: Vec<u32>,
    /// Keep only Gaussians whose mean lies in box:X0,Y0,Z0,X1,Y1,Z1 or sphere:X,Y,Z,R, in world metres [default: all].
    #[arg(long, value_name = "REGION", help_heading = "Inputs")]
    crop: Vec<Crop>,
    /// Drop Gaussians with a lower peak opacity, 0 to 1 [default: 0].
    #[arg(long, value_name = "OPACITY", help_heading = "Inputs")]
    min_opacity: Vec<f64>,
    /// glTF file; repeat it for more. Replaces the job file's.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    mesh: Vec<PathBuf>,
    /// World from the mesh file's coordinates [default: identity].
    #[arg(long, value_name = "TRS", help_heading = "Inputs")]
    mesh_transform: Vec<Transform>,
    /// Name or index of the scene in the mesh file [default: the file's].
    #[arg(long, value_name = "SCENE", help_heading = "Inputs")]
    mesh_scene: Vec<String>,
    /// Material variant of the mesh file, by name [default: none].
    #[arg(long, value_name = "NAME", help_heading = "Inputs")]
    variant: Vec<String>,
    /// What stands for an image of the mesh file that is missing or broken [default: error].
    #[arg(long, value_name = "WHAT", help_heading = "Inputs")]
    missing_texture: Vec<MissingTexture>,
    /// What rays that leave the scene see: linear radiance, or an .exr or .hdr image of all directions, by latitude and
    /// longitude [default: 0,0,0].
    #[arg(long, value_name = "R,G,B|FILE", allow_hyphen_values = true, help_heading = "Inputs")]
    background: Option<Background>,

    /// Folder for the manifest and the probes.
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    output: Option<PathBuf>,
    /// How pixels are stored [default: half].
    #[arg(long, value_name = "TYPE", help_heading = "Output")]
    pixel: Option<Pixel>,
    /// Also write the mean distance along each ray, in metres [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Output")]
    distance: Option<bool>,
    /// What is written for every probe, separated by commas [default: strip].
    #[arg(long, value_name = "KIND,...", value_delimiter = ',', help_heading = "Output")]
    outputs: Vec<OutputKind>,
    /// Most mips of prefiltered radiance [default: 7].
    #[arg(long, value_name = "N", help_heading = "Output")]
    mips: Option<u32>,
    /// How roughness grows along the mips [default: linear].
    #[arg(long, value_name = "CURVE", help_heading = "Output")]
    roughness_curve: Option<RoughnessCurve>,
    /// How KTX2 files store radiance [default: rgba16f].
    #[arg(long, value_name = "ENCODING", help_heading = "Output")]
    hdr_encoding: Option<HdrEncoding>,
    /// Stops by which everything written is brighter than traced [default: 0].
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true, help_heading = "Output")]
    exposure: Option<f32>,
    /// Write light that this tone mapper shows as the splats are, for engines that tone-map reflections but not splats
    /// [default: none].
    #[arg(long, value_name = "MAPPER", help_heading = "Output")]
    match_tonemapper: Option<Tonemapper>,
    /// Also write expanded.exr, in which paper white has this radiance [default: no such file].
    #[arg(long, value_name = "RADIANCE", help_heading = "Output")]
    highlight_expansion: Option<f32>,
    /// Highest band of the spherical harmonics in the manifest: 2 or 3 [default: 2].
    #[arg(long, value_name = "BAND", help_heading = "Output")]
    sh_degree: Option<u8>,
    /// Also store spherical harmonics windowed so that no irradiance is negative [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Output")]
    sh_window: Option<bool>,
    /// Bake light that codes its direction instead of the scene, to check consumers with [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Output")]
    calibration: Option<bool>,
    /// Write run times and counts to this file, as JSON.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    stats: Option<PathBuf>,

    /// Box that the probes serve, in metres [default: what most of the scene fills; for --probe, 5 m around each].
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = parse_numbers::<6>, allow_hyphen_values = true, help_heading = "Placement")]
    bounds: Option<[f64; 6]>,
    /// Probes along x, y and z; each stands in the middle of its cell of the bounds.
    #[arg(long, value_name = "NX,NY,NZ", value_parser = parse_grid, conflicts_with = "probe", help_heading = "Placement")]
    grid: Option<[u32; 3]>,
    /// Probe position in metres, instead of a grid; repeat it for more.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true, help_heading = "Placement")]
    probe: Vec<[f64; 3]>,
    /// Bake the probes of this manifest, of `place` or of a bake, instead of a grid.
    #[arg(long, value_name = "MANIFEST", conflicts_with_all = ["grid", "probe"], help_heading = "Placement")]
    placed: Option<PathBuf>,
    /// Place probes where the blend of the others fails to predict what is there [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Placement")]
    adaptive: Option<bool>,
    /// With --adaptive: heights in metres at which probes stand [default: found from floors and ceilings].
    #[arg(long, value_name = "Y,Y,...", value_delimiter = ',', allow_hyphen_values = true, help_heading = "Placement")]
    levels: Vec<f64>,
    /// With --adaptive: relative error of predicted reflections that no place needs to be below [default: 0.1].
    #[arg(long, value_name = "ERROR", help_heading = "Placement")]
    error: Option<f64>,
    /// With --adaptive: most probes [default: 64].
    #[arg(long, value_name = "N", help_heading = "Placement")]
    max_probes: Option<u32>,
    /// With --adaptive: add no probe after so many seconds; the result then depends on the machine.
    #[arg(long, value_name = "SECONDS", help_heading = "Placement")]
    time: Option<f64>,
    /// With --adaptive: positions, not used otherwise, at which the error is measured [default: 100].
    #[arg(long, value_name = "N", help_heading = "Placement")]
    held_out: Option<u32>,
    /// Fraction of the spacing by which neighbouring influence boxes overlap [default: 0.1].
    #[arg(long, value_name = "FRACTION", help_heading = "Placement")]
    overlap: Option<f64>,

    /// Where settings come from that neither flags nor the job file state [default: standard].
    #[arg(long, value_name = "PRESET", help_heading = "Tracing")]
    preset: Option<Preset>,
    /// Edge of a cube face, in pixels [default: 256].
    #[arg(long, value_name = "PX", help_heading = "Tracing")]
    face_size: Option<u32>,
    /// Rays per pixel and axis: N x N per pixel [default: 1].
    #[arg(long, value_name = "N", help_heading = "Tracing")]
    samples: Option<u32>,
    /// Widen Gaussians so that fine ones do not alias: none, pixel, or train:PX as 3DGS trains at that focal length
    /// [default: none].
    #[arg(long, value_name = "FILTER", help_heading = "Tracing")]
    footprint: Option<Footprint>,
    /// Blending order along a ray [default: what the splat files ask for where they agree, else rayHitDistance].
    #[arg(long, value_name = "ORDER", help_heading = "Tracing")]
    order: Option<Order>,
    /// Direction in which colours of Gaussians are evaluated [default: mean].
    #[arg(long, value_name = "DIRECTION", help_heading = "Tracing")]
    sh_direction: Option<ShDirection>,
    /// End a ray when its transmittance falls below this; 0 never does [default: 1/2048].
    #[arg(long, value_name = "SHARE", help_heading = "Tracing")]
    t_cutoff: Option<f32>,
    /// Ignore what is nearer than this, in metres [default: 0].
    #[arg(long, value_name = "METRES", help_heading = "Tracing")]
    t_near: Option<f32>,
    /// How light leaves a mesh's surface [default: unlit].
    #[arg(long, value_name = "MODEL", help_heading = "Tracing")]
    surface: Option<Surface>,
    /// Darken Gaussians near meshes by the ambient light that the meshes keep from them [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Tracing")]
    mesh_shadows: Option<bool>,
    /// Refine surfaces lit by path tracing to this standard error, a share of their light; 0 always takes --max-paths
    /// [default: 0.02].
    #[arg(long, value_name = "SHARE", help_heading = "Tracing")]
    noise: Option<f32>,
    /// Most paths per ray that meets a surface [default: 1024].
    #[arg(long, value_name = "N", help_heading = "Tracing")]
    max_paths: Option<u32>,
    /// What computes the radiance along rays [default: beam].
    #[arg(long, value_name = "TRACER", help_heading = "Tracing")]
    tracer: Option<Tracer>,

    /// Threads to work with; 0 is one per core. The result does not depend on it [default: 0].
    #[arg(long, value_name = "N", help_heading = "Running")]
    threads: Option<usize>,
    /// How progress is shown on stderr [default: auto].
    #[arg(long, value_name = "STYLE", help_heading = "Running")]
    progress: Option<ProgressStyle>,
    /// Keep results in this folder, and take from it what is the same: unchanged probes are not baked again, and of changed
    /// ones only the tiles that see the change. Bakes share it [default: none].
    #[arg(long, value_name = "DIR", help_heading = "Running")]
    cache: Option<PathBuf>,
    /// Keep nothing, not even what is done of a bake that is interrupted [default: false].
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "true", value_name = "BOOL", help_heading = "Running")]
    no_cache: Option<bool>,
    /// Bake part I of N of the probes; `merge` joins the parts [default: all].
    #[arg(long, value_name = "I/N", help_heading = "Running")]
    shard: Option<Shard>,
    /// Write all inputs to this file, as a rule of Make.
    #[arg(long, value_name = "FILE", help_heading = "Running")]
    depfile: Option<PathBuf>,
    /// Begin no probe after so many seconds; exit code 3 then says that the manifest names probes without images.
    #[arg(long, value_name = "SECONDS", help_heading = "Running")]
    time_budget: Option<f64>,
    /// Keep the scene, its tree and the cubemaps under way within this, such as 4GiB: fewer probes are baked at a time, and
    /// what cannot fit is refused before it is read [default: no limit].
    #[arg(long, value_name = "SIZE", help_heading = "Running")]
    max_memory: Option<ByteSize>,
}

impl Bake {
    pub fn run(self) -> Result<String> {
        let job = self.into_job()?;
        let report = pipeline::bake(&job, &*progress::reporter(job.progress), cancelled_by_signal())?;
        match report.unfinished_probes {
            0 => Ok(format!("{}\n", report.manifest.display())),
            probes => Err(Error::Unfinished { manifest: report.manifest, probes }),
        }
    }

    /// The job file's settings, or the defaults, overridden by the flags.
    pub fn into_job(self) -> Result<Job> {
        let mut job = match self.job {
            Some(path) => Job::from_file(&path, self.preset)?,
            None => self.preset.unwrap_or_default().job(),
        };

        if !self.splats.is_empty() {
            job.splats = self.splats.into_iter().map(SplatInput::new).collect();
        }
        describe("--splat-frame", self.splat_frame, &mut job.splats, |input, frame| input.frame = Some(frame))?;
        describe("--splat-transform", self.splat_transform, &mut job.splats, |input, world| input.transform = world)?;
        describe("--splat-encoding", self.splat_encoding, &mut job.splats, |input, it| input.encoding = Some(it))?;
        describe("--lod", self.lod, &mut job.splats, |input, lod| input.lod = Some(lod))?;
        describe("--crop", self.crop, &mut job.splats, |input, crop| input.crop = Some(crop))?;
        describe("--min-opacity", self.min_opacity, &mut job.splats, |input, opacity| input.min_opacity = opacity)?;
        if !self.mesh.is_empty() {
            job.meshes = self.mesh.into_iter().map(MeshInput::new).collect();
        }
        describe("--mesh-transform", self.mesh_transform, &mut job.meshes, |input, world| input.transform = world)?;
        describe("--mesh-scene", self.mesh_scene, &mut job.meshes, |input, scene| input.scene = Some(scene))?;
        describe("--variant", self.variant, &mut job.meshes, |input, name| input.variant = Some(name))?;
        describe("--missing-texture", self.missing_texture, &mut job.meshes, |input, it| input.missing_texture = it)?;

        // Flags for kinds of placement replace what the job file says of any.
        if self.adaptive == Some(true) || self.placed.is_some() || self.grid.is_some() || !self.probe.is_empty() {
            job.placement.adaptive = false;
            job.placement.placed = self.placed;
            job.placement.grid = self.grid;
            job.placement.probes = self.probe;
        }
        if !self.levels.is_empty() {
            job.placement.levels = self.levels;
        }
        job.placement.time = self.time.or(job.placement.time);
        job.placement.bounds = self.bounds.or(job.placement.bounds);
        job.output = self.output.or(job.output);
        job.stats = self.stats.or(job.stats);
        job.cache = self.cache.or(job.cache);
        job.shard = self.shard.or(job.shard);
        job.depfile = self.depfile.or(job.depfile);
        job.time_budget = self.time_budget.or(job.time_budget);
        job.max_memory = self.max_memory.or(job.max_memory);
        job.order = self.order.or(job.order);

        set(&mut job.placement.overlap, self.overlap);
        set(&mut job.placement.adaptive, self.adaptive);
        set(&mut job.placement.error, self.error);
        set(&mut job.placement.max_probes, self.max_probes);
        set(&mut job.placement.held_out, self.held_out);
        set(&mut job.background, self.background);
        set(&mut job.pixel, self.pixel);
        set(&mut job.distance, self.distance);
        if !self.outputs.is_empty() {
            job.outputs = self.outputs;
        }
        set(&mut job.mips, self.mips);
        set(&mut job.roughness_curve, self.roughness_curve);
        set(&mut job.hdr_encoding, self.hdr_encoding);
        set(&mut job.exposure, self.exposure);
        set(&mut job.match_tonemapper, self.match_tonemapper);
        job.highlight_expansion = self.highlight_expansion.or(job.highlight_expansion);
        set(&mut job.sh_degree, self.sh_degree);
        set(&mut job.sh_window, self.sh_window);
        set(&mut job.calibration, self.calibration);
        set(&mut job.face_size, self.face_size);
        set(&mut job.samples, self.samples);
        set(&mut job.footprint, self.footprint);
        set(&mut job.sh_direction, self.sh_direction);
        set(&mut job.t_cutoff, self.t_cutoff);
        set(&mut job.t_near, self.t_near);
        set(&mut job.surface, self.surface);
        set(&mut job.mesh_shadows, self.mesh_shadows);
        set(&mut job.noise, self.noise);
        set(&mut job.max_paths, self.max_paths);
        set(&mut job.tracer, self.tracer);
        set(&mut job.threads, self.threads);
        set(&mut job.progress, self.progress);
        set(&mut job.no_cache, self.no_cache);
        Ok(job)
    }
}

fn set<T>(field: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *field = value;
    }
}

/// Gives the values of a repeated flag to the inputs in order, or a single value to all of them.
fn describe<I, T: Clone>(flag: &str, values: Vec<T>, inputs: &mut [I], describe: impl Fn(&mut I, T)) -> Result<()> {
    match values.len() {
        1 if !inputs.is_empty() => inputs.iter_mut().for_each(|input| describe(input, values[0].clone())),
        given if given == inputs.len() || given == 0 => {
            inputs.iter_mut().zip(values).for_each(|(input, value)| describe(input, value));
        }
        given => {
            let why = format!("given {given} times for {} files: give it once for all, or once for each", inputs.len());
            return Err(Error::request(flag, why));
        }
    }
    Ok(())
}

fn parse_grid(text: &str) -> std::result::Result<[u32; 3], String> {
    let counts: Option<Vec<u32>> = text.split(',').map(|count| count.trim().parse().ok()).collect();
    counts
        .and_then(|counts| counts.try_into().ok())
        .ok_or_else(|| format!("'{text}' is not three whole numbers separated by commas"))
}

/// A flag that Ctrl-C (or a request to terminate) sets, so that the bake ends cleanly; a second one ends the process.
pub fn cancelled_by_signal() -> &'static AtomicBool {
    static CANCELLED: AtomicBool = AtomicBool::new(false);
    let handler = || {
        if CANCELLED.swap(true, Ordering::Relaxed) {
            std::process::exit(1);
        }
    };
    // Without a handler Ctrl-C ends the process at once, which is the system's default.
    let _ = ctrlc::set_handler(handler);
    &CANCELLED
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        bake: Bake,
    }

    fn job(line: &[&str]) -> Result<Job> {
        Line::try_parse_from([&["bake"], line].concat()).unwrap().bake.into_job()
    }

    #[test]
    fn without_flags_a_job_is_the_default() {
        assert_eq!(job(&[]).unwrap(), Job::default());
    }

    #[test]
    fn every_field_of_a_job_has_a_flag_that_overrides_the_job_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.json");
        let text = r#"{"splats": [{"path": "a.ply"}], "placement": {"probes": [[1, 2, 3]]}, "faceSize": 8}"#;
        std::fs::write(&path, text).unwrap();
        let line = "--splats b.ply --splat-frame rub --splat-transform s=2 --splat-encoding lin-scene --crop sphere:-1,2,3,4 \
            --min-opacity 0.25 --lod 2 --mesh c.glb --mesh-transform t=1,2,3 --mesh-scene 1 --variant red --missing-texture magenta --background 1,2,3 -o out --pixel float --distance --stats s.json --outputs mips,latlong-hdr --mips 5 --roughness-curve unity --hdr-encoding rgb9e5 --exposure -1.5 --match-tonemapper pbr-neutral --highlight-expansion 8 --sh-degree 3 --sh-window --calibration \
            --bounds -1,-2,-3,1,2,3 --grid 2,3,4 --overlap 0.5 --preset draft --face-size 16 --samples 2 --footprint train:800 --order cameraDistance \
            --sh-direction ray --t-cutoff 0 --t-near 0.5 --surface path --noise 0.5 --max-paths 64 --tracer reference --threads 3 --progress json \
            --cache kept --no-cache --shard 2/7 --depfile out.d --time-budget 1.5 --max-memory 3GiB";
        let line: Vec<&str> = [path.to_str().unwrap()].into_iter().chain(line.split_whitespace()).collect();
        let expected = r#"{
            "splats": [{"path": "b.ply", "frame": "rub", "transform": {"scale": [2, 2, 2]}, "encoding": "lin-scene",
                "lod": 2, "crop": {"sphere": [-1, 2, 3, 4]}, "minOpacity": 0.25}],
            "meshes": [{"path": "c.glb", "transform": {"translation": [1, 2, 3]}, "scene": "1",
                "variant": "red", "missingTexture": "magenta"}],
            "output": "out", "stats": "s.json", "progress": "json", "threads": 3, "background": [1, 2, 3],
            "pixel": "float", "distance": true, "outputs": ["mips", "latlong-hdr"], "mips": 5, "roughnessCurve": "unity",
            "hdrEncoding": "rgb9e5", "exposure": -1.5, "matchTonemapper": "pbr-neutral", "highlightExpansion": 8, "shDegree": 3, "shWindow": true, "calibration": true, "preset": "draft", "faceSize": 16, "samples": 2, "footprint": "train:800", "order": "cameraDistance",
            "shDirection": "ray", "tCutoff": 0, "tNear": 0.5, "surface": "path", "noise": 0.5, "maxPaths": 64, "tracer": "reference",
            "cache": "kept", "noCache": true, "shard": "2/7", "depfile": "out.d", "timeBudget": 1.5, "maxMemory": "3.0 GiB",
            "placement": {"bounds": [-1, -2, -3, 1, 2, 3], "grid": [2, 3, 4], "overlap": 0.5}
        }"#;
        let expected = Job { file: Some(path.clone()), ..serde_json::from_str(expected).unwrap() };
        assert_eq!(job(&line).unwrap(), expected);
    }

    #[test]
    fn a_preset_gives_what_is_not_stated() {
        assert_eq!(job(&["--preset", "draft"]).unwrap(), Preset::Draft.job());
        let reference = job(&["--preset", "reference", "--samples", "1"]).unwrap();
        assert_eq!(reference, Job { samples: 1, ..Preset::Reference.job() });
    }

    #[test]
    fn adaptive_placement_replaces_the_job_files_probes_and_every_field_of_it_has_a_flag() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.json");
        std::fs::write(&path, r#"{"placement": {"grid": [1, 2, 3], "maxProbes": 9}}"#).unwrap();
        let line = "--adaptive --levels -1.5,2 --error 0.25 --max-probes 7 --time 1.5 --held-out 3";
        let line: Vec<&str> = [path.to_str().unwrap()].into_iter().chain(line.split_whitespace()).collect();
        let expected = r#"{"placement": {"adaptive": true, "levels": [-1.5, 2], "error": 0.25, "maxProbes": 7, "time": 1.5, "heldOut": 3}}"#;
        let expected = Job { file: Some(path.clone()), ..serde_json::from_str(expected).unwrap() };
        assert_eq!(job(&line).unwrap(), expected);
        let placed = job(&[path.to_str().unwrap(), "--placed", "plan/manifest.json"]).unwrap().placement;
        assert_eq!((placed.placed, placed.grid), (Some("plan/manifest.json".into()), None));
        assert!(!job(&["--adaptive=false", "--probe", "0,0,0"]).unwrap().placement.adaptive);
        let both = job(&["--splats", "a.ply", "-o", "out", "--adaptive", "--probe", "0,0,0"]).unwrap();
        assert!(both.validate().unwrap_err().to_string().contains("only one of"));
    }

    #[test]
    fn a_description_belongs_to_the_input_of_its_place_or_to_all() {
        let two = ["--splats", "a.ply", "--splats", "b.ply"];
        let frames = |line: &[&str]| {
            job(&[&two, line].concat()).map(|job| job.splats.iter().map(|input| input.frame).collect::<Vec<_>>())
        };
        let each = frames(&["--splat-frame", "rub", "--splat-frame", "rdf"]).unwrap();
        assert_eq!(each, [Some(Frame::RUB), Some(Frame::RDF)]);
        assert_eq!(frames(&["--splat-frame", "rdf"]).unwrap(), [Some(Frame::RDF); 2]);
        let error = frames(&["--splat-frame", "rub", "--splat-frame", "rdf", "--splat-frame", "rdf"]).unwrap_err();
        assert!(error.to_string().contains("--splat-frame: given 3 times for 2 files"), "{error}");
        assert!(job(&["--mesh-scene", "1"]).is_err());
    }

    #[test]
    fn probe_positions_may_be_negative_and_repeat() {
        let job = job(&["--probe", "-1,-2.5,3", "--probe", "0,0,-1e1", "--distance=false"]).unwrap();
        assert_eq!(job.placement.probes, [[-1.0, -2.5, 3.0], [0.0, 0.0, -10.0]]);
        assert!(!job.distance);
    }
}
