//! The files of one probe, and what the manifest says about them.

use std::cell::OnceCell;
use std::path::Path;

use glam::Vec3;

use crate::bake::Cubemap;
use crate::encode::exr::{DISTANCE_CHANNEL, Part, RADIANCE_FILE, write_cubemap, write_parts};
use crate::encode::latlong::Latlong;
use crate::encode::preview::write_png;
use crate::encode::slots::Slots;
use crate::encode::{ktx2, rgbd};
use crate::filter::moments::{MOMENTS_SIZE, distance_moments};
use crate::filter::prefilter::RoughnessMip;
use crate::filter::{Prefilter, RgbCubemap, Sampler, ShRadiance};
use crate::job::{HdrEncoding, Job, OutputKind, Pixel};
use crate::manifest::{
    self, FileFormat, FileRecord, FileRole, Layout, MipRecord, PixelFormat, ShRecord, TexelSampling, WindowedSh,
};
use crate::place::Probe;
use crate::trace::Face;
use crate::{Error, Result};

/// Edge of an irradiance cubemap's faces: irradiance has no finer detail.
const IRRADIANCE_SIZE: u32 = 32;

/// Faces are averaged down to this before they are projected on spherical harmonics: what is finer changes coefficients of
/// bands up to 3 by less than a thousandth.
const SH_SIZE: u32 = 64;

/// No distance counts for more than this many diagonals of the influence box (RTXGI: one and a half spacings of probes).
const MAX_DISTANCE: f64 = 1.5;

/// File names of faces, as engines and tools shorten them.
const FACE_NAMES: [&str; 6] = ["px", "nx", "py", "ny", "pz", "nz"];

/// The files of a probe on their way to its folder.
pub(super) struct ProbeFiles<'a> {
    pub job: &'a Job,
    /// The probe's folder.
    pub folder: &'a Path,
    pub probe: &'a Probe,
    /// What was written.
    pub records: Vec<FileRecord>,
    /// Channel values that half floats could not hold.
    pub clamped_values: usize,
}

impl<'a> ProbeFiles<'a> {
    pub fn new(job: &'a Job, folder: &'a Path, probe: &'a Probe) -> Self {
        Self { job, folder, probe, records: Vec::new(), clamped_values: 0 }
    }

    /// Writes all that the job asks for, except the `envmap`, whose rays are others. `cubemap` is exposed already; it loses
    /// distances that are not to be seen.
    pub fn write(&mut self, cubemap: &mut Cubemap) -> Result<ShRecord> {
        let texels = cubemap.texels.iter().map(|&[r, g, b, _]| Vec3::new(r, g, b)).collect();
        let rgb = RgbCubemap::new(cubemap.face_size, texels);
        let rgb = rgb.map_err(|error| Error::request(&self.probe.id, error.to_string()))?;
        let sh = self.sh(&rgb);
        let distances = if self.job.distance { cubemap.distance.clone() } else { cubemap.distance.take() };
        let filtered = Filtered::new(rgb, self.job);
        for kind in &self.job.outputs {
            match kind {
                OutputKind::Strip => self.strip(cubemap)?,
                OutputKind::Faces => self.faces(cubemap)?,
                OutputKind::Mips => self.mips(filtered.chain())?,
                OutputKind::Irradiance => self.irradiance(filtered.irradiance())?,
                OutputKind::Latlong => self.latlong(filtered.prefilter().mirror())?,
                OutputKind::LatlongHdr => self.latlong_hdr(filtered.prefilter().mirror())?,
                OutputKind::Envmap => {}
                OutputKind::Ktx2 => {
                    self.specular_ktx2(filtered.chain())?;
                    self.irradiance_ktx2(filtered.irradiance())?;
                }
                OutputKind::Rgbd => self.rgbd(filtered.chain())?,
                OutputKind::Moments => self.moments(cubemap, distances.as_deref().unwrap_or_default())?,
            }
        }
        Ok(sh)
    }

    /// Writes the `envmap` from a cubemap with texels on the edges.
    pub fn write_envmap(&mut self, cubemap: &Cubemap) -> Result<()> {
        let name = "envmap.exr";
        let size = cubemap.face_size;
        let part = Part { is_envmap: true, ..Part::cubemap(cubemap, 0..6 * size as usize, self.job.pixel) };
        self.clamped_values += write_parts(&self.folder.join(name), vec![part])?;
        let record = self.add(name, FileRole::Radiance, FileFormat::Exr, Layout::Strip, [size, 6 * size])?;
        record.texel_sampling = TexelSampling::Edge;
        record.channels = names(&["A", "B", "G", "R"]);
        Ok(())
    }

    fn strip(&mut self, radiance: &Cubemap) -> Result<()> {
        self.clamped_values += write_cubemap(&self.folder.join(RADIANCE_FILE), radiance, self.job.pixel)?;
        let size = [radiance.face_size, 6 * radiance.face_size];
        let record = self.add(RADIANCE_FILE, FileRole::Radiance, FileFormat::Exr, Layout::Strip, size)?;
        record.channels = radiance_channels(radiance);
        Ok(())
    }

    fn faces(&mut self, radiance: &Cubemap) -> Result<()> {
        let size = radiance.face_size;
        for (face, short) in Face::ALL.into_iter().zip(FACE_NAMES) {
            let name = format!("radiance_{short}.exr");
            let first = face as usize * size as usize;
            let part = Part::cubemap(radiance, first..first + size as usize, self.job.pixel);
            self.clamped_values += write_parts(&self.folder.join(&name), vec![part])?;
            let record = self.add(&name, FileRole::Radiance, FileFormat::Exr, Layout::Face, [size; 2])?;
            record.channels = radiance_channels(radiance);
            record.face = Some(face.name().into());
        }
        Ok(())
    }

    fn mips(&mut self, chain: &[RoughnessMip]) -> Result<()> {
        let name = "specular.exr";
        let part = |(i, mip): (usize, &RoughnessMip)| Part {
            name: Some(format!("mip {i}")),
            ..Part::rgb(mip.cubemap.size() as usize, mip.cubemap.texels(), self.job.pixel)
        };
        let parts = chain.iter().enumerate().map(part).collect();
        self.clamped_values += write_parts(&self.folder.join(name), parts)?;
        let size = first_size(chain);
        let record = self.add(name, FileRole::Specular, FileFormat::Exr, Layout::Strip, [size, 6 * size])?;
        record.mips = mip_records(chain, 6);
        Ok(())
    }

    fn irradiance(&mut self, irradiance: &RgbCubemap) -> Result<()> {
        let (name, size) = ("irradiance.exr", irradiance.size());
        let part = Part::rgb(size as usize, irradiance.texels(), self.job.pixel);
        self.clamped_values += write_parts(&self.folder.join(name), vec![part])?;
        self.add(name, FileRole::Irradiance, FileFormat::Exr, Layout::Strip, [size, 6 * size]).map(drop)
    }

    fn latlong(&mut self, sampler: &Sampler) -> Result<()> {
        let name = "latlong.exr";
        let image = Latlong::new(sampler, 2 * self.job.face_size);
        let part = Part::rgb(2 * image.height as usize, &image.pixels, self.job.pixel);
        self.clamped_values += write_parts(&self.folder.join(name), vec![part])?;
        let size = [2 * image.height, image.height];
        self.add(name, FileRole::Radiance, FileFormat::Exr, Layout::Latlong, size).map(drop)
    }

    fn latlong_hdr(&mut self, sampler: &Sampler) -> Result<()> {
        let name = "latlong.hdr";
        let image = Latlong::new(sampler, 2 * self.job.face_size);
        image.write_hdr(&self.folder.join(name))?;
        let size = [2 * image.height, image.height];
        let record = self.add(name, FileRole::Radiance, FileFormat::Hdr, Layout::Latlong, size)?;
        record.pixel = PixelFormat::Rgbe;
        Ok(())
    }

    fn specular_ktx2(&mut self, chain: &[RoughnessMip]) -> Result<()> {
        let mips: Vec<&RgbCubemap> = chain.iter().map(|mip| &mip.cubemap).collect();
        let record = self.ktx2("specular.ktx2", FileRole::Specular, &mips)?;
        record.mips = mip_records(chain, 1);
        Ok(())
    }

    fn irradiance_ktx2(&mut self, irradiance: &RgbCubemap) -> Result<()> {
        self.ktx2("irradiance.ktx2", FileRole::Irradiance, &[irradiance]).map(drop)
    }

    fn ktx2(&mut self, name: &str, role: FileRole, mips: &[&RgbCubemap]) -> Result<&mut FileRecord> {
        ktx2::write(&self.folder.join(name), mips, &Slots::DIRECT, self.job.hdr_encoding)?;
        let size = mips.first().map_or(0, |mip| mip.size());
        let encoding = self.job.hdr_encoding;
        let record = self.add(name, role, FileFormat::Ktx2, Layout::Cube, [size; 2])?;
        (record.pixel, record.channels) = match encoding {
            HdrEncoding::Rgba16f => (PixelFormat::Half, names(&["A", "B", "G", "R"])),
            HdrEncoding::Rgb9e5 => (PixelFormat::Rgb9e5, names(&["B", "G", "R"])),
        };
        Ok(record)
    }

    fn rgbd(&mut self, chain: &[RoughnessMip]) -> Result<()> {
        for (i, mip) in chain.iter().enumerate() {
            let (name, size) = (format!("rgbd_{i}.png"), mip.cubemap.size());
            write_png(&self.folder.join(&name), &rgbd::encode(size, mip.cubemap.texels()))?;
            let record = self.add(&name, FileRole::Specular, FileFormat::Png, Layout::Strip, [size, 6 * size])?;
            record.pixel = PixelFormat::Rgbd;
            record.channels = names(&["A", "B", "G", "R"]);
            record.mips = mip_records(&chain[i..=i], 6);
        }
        Ok(())
    }

    fn moments(&mut self, cubemap: &Cubemap, distances: &[f32]) -> Result<()> {
        let max_distance = MAX_DISTANCE * self.probe.influence.extent().length();
        let coverages = cubemap.texels.iter().map(|texel| texel[3]);
        let moments = distance_moments(cubemap.face_size, distances, coverages, max_distance as f32)?;
        let name = "moments.exr";
        let channel = |index: usize| moments.iter().map(|moment| moment[index]).collect();
        let edge = MOMENTS_SIZE as usize;
        let channels = vec![("R", Pixel::Float, channel(0)), ("G", Pixel::Float, channel(1))];
        let part = Part { name: None, width: edge, height: edge, channels, is_envmap: false };
        write_parts(&self.folder.join(name), vec![part])?;
        let record = self.add(name, FileRole::Moments, FileFormat::Exr, Layout::Octahedral, [MOMENTS_SIZE; 2])?;
        record.pixel = PixelFormat::Float;
        record.channels = names(&["G", "R"]);
        record.max_distance = Some(max_distance);
        Ok(())
    }

    /// Remembers a file that was written; linear R, G, B at pixel centres, stored as the job says, if nothing else is said.
    fn add(
        &mut self,
        name: &str,
        role: FileRole,
        format: FileFormat,
        layout: Layout,
        [width, height]: [u32; 2],
    ) -> Result<&mut FileRecord> {
        let (bytes, blake3) = manifest::digest(&self.folder.join(name))?;
        let path = format!("{}/{name}", self.probe.id);
        Ok(self.records.push_mut(FileRecord {
            path,
            role,
            format,
            layout,
            width,
            height,
            pixel: self.job.pixel.into(),
            texel_sampling: TexelSampling::Center,
            channels: names(&["B", "G", "R"]),
            face: None,
            mips: Vec::new(),
            max_distance: None,
            bytes,
            blake3,
        }))
    }

    fn sh(&self, rgb: &RgbCubemap) -> ShRecord {
        let sh = ShRadiance::project(&rgb.reduced(rgb.size().min(SH_SIZE)), self.job.sh_degree);
        let coefficients = |sh: &ShRadiance| sh.coefficients().iter().map(|c| c.to_array()).collect();
        let windowed = self.job.sh_window.then(|| {
            let (windowed, width) = sh.windowed();
            WindowedSh { width, coefficients: coefficients(&windowed) }
        });
        ShRecord { degree: sh.degree(), basis: ShRecord::BASIS.into(), coefficients: coefficients(&sh), windowed }
    }
}

/// What several files share, made when the first of them asks for it.
struct Filtered<'a> {
    source: RgbCubemap,
    job: &'a Job,
    prefilter: OnceCell<Prefilter>,
    chain: OnceCell<Vec<RoughnessMip>>,
    irradiance: OnceCell<RgbCubemap>,
}

impl<'a> Filtered<'a> {
    fn new(source: RgbCubemap, job: &'a Job) -> Self {
        Self { source, job, prefilter: OnceCell::new(), chain: OnceCell::new(), irradiance: OnceCell::new() }
    }

    fn prefilter(&self) -> &Prefilter {
        self.prefilter.get_or_init(|| Prefilter::new(self.source.clone()))
    }

    fn chain(&self) -> &[RoughnessMip] {
        self.chain.get_or_init(|| self.prefilter().chain(self.job.roughness_curve, self.job.mips))
    }

    fn irradiance(&self) -> &RgbCubemap {
        let size = self.source.size().min(IRRADIANCE_SIZE);
        self.irradiance.get_or_init(|| self.prefilter().irradiance(size))
    }
}

fn names(channels: &[&str]) -> Vec<String> {
    channels.iter().map(|&name| name.into()).collect()
}

fn radiance_channels(radiance: &Cubemap) -> Vec<String> {
    let distance = radiance.distance.as_ref().map(|_| DISTANCE_CHANNEL);
    ["A", "B", "G", "R"].into_iter().chain(distance).map(String::from).collect()
}

fn first_size(chain: &[RoughnessMip]) -> u32 {
    chain.first().map_or(0, |mip| mip.cubemap.size())
}

/// `faces` is how many of them lie one below the other.
fn mip_records(chain: &[RoughnessMip], faces: u32) -> Vec<MipRecord> {
    let record = |mip: &RoughnessMip| {
        let width = mip.cubemap.size();
        MipRecord { roughness: mip.roughness, width, height: faces * width }
    };
    chain.iter().map(record).collect()
}
