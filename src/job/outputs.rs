//! What a bake writes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A kind of file that a bake writes for every probe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum OutputKind {
    /// `radiance.exr`: radiance and coverage, six faces one below the other.
    Strip,
    /// `radiance_px.exr` to `radiance_nz.exr`: the same, a file per face.
    Faces,
    /// `specular.exr`: radiance prefiltered for rough reflection, a part per mip, each six faces one below the other.
    Mips,
    /// `irradiance.exr`: irradiance over pi, by normal, six faces one below the other.
    Irradiance,
    /// `latlong.exr`: radiance by latitude and longitude.
    Latlong,
    /// `latlong.hdr`: the same as Radiance RGBE.
    LatlongHdr,
    /// `envmap.exr`: six faces with texels on the edges, traced in those directions, marked as OpenEXR's `envmap`.
    Envmap,
    /// `specular.ktx2` and `irradiance.ktx2`: cube maps for graphics APIs, the first with a mip per roughness.
    Ktx2,
    /// `rgbd_0.png` and so on: prefiltered radiance as 8 bit RGBD, a file per mip, six faces one below the other.
    Rgbd,
    /// `moments.exr`: mean distance and mean squared distance by direction, octahedral.
    Moments,
}

/// How roughness grows along a chain of mips. With l the mip's index over the index of the last mip:
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum RoughnessCurve {
    /// r = l: Bevy, EXT_lights_image_based. The default.
    #[default]
    Linear,
    /// r (2 - r) = l: Filament (IndirectLight.h), three.js.
    Filament,
    /// r (1.7 - 0.7 r) = l: Unity (ImageBasedLighting.hlsl), whose shaders expect 7 mips.
    Unity,
    /// The same roughness for the same edge of a face, whatever the size of mip 0: 1 at 2 px and `2^(-1/1.2)` of it with
    /// each doubling (Karis 2013; Unreal's ReflectionEnvironmentShared.ush).
    Unreal,
}

/// How KTX2 files store radiance.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum HdrEncoding {
    /// Four half floats. The default.
    #[default]
    Rgba16f,
    /// Nine bits per channel and a shared exponent of five: half the size, values up to 65408 and none below 0.
    Rgb9e5,
}
