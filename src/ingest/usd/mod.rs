//! USD stages (.usda, .usdc, .usdz): opened, walked, and closed again, on a thread of their own.
//!
//! The `openusd` crate composes the layers. It knows no schemas, so that fallback values are written down here, and it
//! trusts its input, so that layers are checked before they get there ([`resolver`], [`crate_check`]) and a panic of the
//! crate is an error of the file.

mod binding;
mod crate_check;
mod instancer;
mod light;
mod material;
mod mesh;
mod meshes;
mod network;
mod polygon;
mod preview;
mod primvar;
mod resolver;
mod splats;
mod texture;
mod values;
mod walk;
mod xform;

use std::cell::Cell;
use std::path::Path;

use openusd::sdf::Value;
use openusd::usd::{Attribute, Prim, Stage, TimeCode};

use self::resolver::{FolderResolver, PACKAGE_MAGIC};
use self::values::{integers, vectors};
use crate::error::{Error, Result};
use crate::job::Frame;

pub(super) use meshes::{contents, load};
pub(super) use splats::open_splats;

/// The reader recurses over composition arcs and namespaces.
const STACK_BYTES: usize = 256 << 20;

/// Whether a file's bytes are a USD layer, or a package whose first entry is one.
pub(super) fn is_usd(bytes: &[u8]) -> bool {
    // A zip archive's first entry: the length of its name is at byte 26, the name at byte 30.
    let is_package = || {
        let length = bytes.get(26..28).map_or(0, |length| usize::from(length[0]) | usize::from(length[1]) << 8);
        let name = bytes.get(30..30 + length).unwrap_or_default();
        [&b".usd"[..], b".usda", b".usdc"].iter().any(|extension| name.ends_with(extension))
    };
    bytes.starts_with(crate_check::MAGIC)
        || bytes.starts_with(b"#usda")
        || bytes.starts_with(PACKAGE_MAGIC) && is_package()
}

/// A stage and what it says of itself.
struct OpenedStage<'a> {
    path: &'a Path,
    stage: Stage,
    metres_per_unit: f64,
    frame: Frame,
    resolver: FolderResolver,
    /// What has been visited so far.
    work: Cell<usize>,
}

/// Opens the stage at `path` and hands it to `read`, on a thread of its own: a stage stays on one, it needs a deep stack,
/// and a panic of the reader ends there.
fn with_stage<T: Send>(path: &Path, read: impl FnOnce(&OpenedStage) -> Result<T> + Send) -> Result<T> {
    let work = || read(&OpenedStage::open(path)?);
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("usd".into()).stack_size(STACK_BYTES);
        let running = thread.spawn_scoped(scope, work).map_err(|source| Error::read(path, source))?;
        running.join().unwrap_or_else(|_| Err(Error::invalid(path, "stage", "broken: the USD reader gave up on it")))
    })
}

impl<'a> OpenedStage<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let extension = path.extension().map(|extension| extension.to_ascii_lowercase());
        if !extension.is_some_and(|it| ["usd", "usda", "usdc", "usdz"].iter().any(|known| it == *known)) {
            let what =
                "USD in a file of another name; rename it to end with .usd or .usdz, which is how layers are told";
            return Err(Error::unsupported(path, what));
        }
        let name = path.to_str().ok_or_else(|| Error::unsupported(path, "USD with a path that is not UTF-8"))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let resolver = FolderResolver::new(folder).map_err(|source| Error::read(path, source))?;
        let stage = Stage::builder().resolver(resolver.clone()).open(name);
        let stage = stage.map_err(|error| Error::invalid(path, "stage", format!("{error:#}")))?;
        let metadata =
            |name: &str| stage.stage_metadata(name).map_err(|error| Error::invalid(path, name, format!("{error:#}")));
        // Without one a stage is in centimetres (UsdGeomLinearUnits).
        let metres_per_unit = match metadata("metersPerUnit")? {
            None => 0.01,
            Some(value) => values::numbers(&value).filter(|it| it.len() == 1).map_or(f64::NAN, |it| it[0]),
        };
        if !(1e-9..=1e9).contains(&metres_per_unit) {
            return Err(Error::invalid(path, "metersPerUnit", "it is not a positive number"));
        }
        let frame = match metadata("upAxis")? {
            None => Frame::RUB,
            Some(Value::Token(axis)) if axis == "Y" => Frame::RUB,
            Some(Value::Token(axis)) if axis == "Z" => Frame::RFU,
            Some(other) => return Err(Error::invalid(path, "upAxis", format!("{other:?} is neither Y nor Z"))),
        };
        let opened = Self { path, stage, metres_per_unit, frame, resolver, work: Cell::new(0) };
        opened.check_composition()?;
        Ok(opened)
    }

    /// Refuses a stage of which a part was found missing so far: left out silently, it would be missing in the bake.
    fn check_composition(&self) -> Result<()> {
        match self.stage.composition_errors().first() {
            Some(error) => Err(Error::invalid(self.path, "stage", error.to_string())),
            None => Ok(()),
        }
    }

    /// The type of a prim; empty without one.
    fn kind(&self, prim: &Prim) -> Result<String> {
        Ok(self.ask(prim, prim.type_name())?.map_or_else(String::new, |kind| kind.to_string()))
    }

    /// The value of an attribute: its default, else its first time sample. A blocked value is none.
    fn value(&self, prim: &Prim, name: &str) -> Result<Option<Value>> {
        // Tokens of the file name attributes, too. What no attribute can be called is not looked for: over a stray brace
        // the reader loops without end.
        if !name.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | ':')) {
            return Ok(None);
        }
        self.attribute_value(prim, &prim.attribute(name))
    }

    /// The value of `attribute`, for `prim`.
    fn attribute_value(&self, prim: &Prim, attribute: &Attribute) -> Result<Option<Value>> {
        let mut value = self.ask(prim, attribute.get::<Value>())?;
        if value.is_none()
            && let Some(&first) = self.ask(prim, attribute.time_sample_times())?.first()
        {
            value = self.ask(prim, attribute.get_at::<Value>(TimeCode::new(first)))?;
            // The samples of text layers do not tell tokens from strings; the attribute does.
            if let Some(Value::String(text)) = &value
                && self.ask(prim, attribute.type_name())?.is_some_and(|kind| kind == "token")
            {
                value = Some(Value::token(text.as_str()));
            }
        }
        Ok(value.filter(|value| !matches!(value, Value::ValueBlock | Value::None)))
    }

    /// Metadata of the prim or property at `path`, for `prim`.
    fn metadata(&self, prim: &Prim, path: &openusd::sdf::Path, name: &str) -> Result<Option<Value>> {
        self.ask(prim, self.stage.attribute(path.clone()).get_metadata::<Value>(name))
    }

    fn token(&self, prim: &Prim, name: &str) -> Result<Option<String>> {
        match self.value(prim, name)? {
            None => Ok(None),
            Some(Value::Token(token)) => Ok(Some(token.to_string())),
            Some(_) => Err(self.invalid(prim, format!("{name} is not a token"))),
        }
    }

    /// The elements of the integer array `name`, none where it is absent.
    fn integers(&self, prim: &Prim, name: &str) -> Result<Vec<i64>> {
        let Some(value) = self.value(prim, name)? else { return Ok(Vec::new()) };
        integers(value).ok_or_else(|| self.invalid(prim, format!("{name} is not an array of integers")))
    }

    /// The vectors of the array `name`, if it is there.
    fn vectors<const N: usize>(&self, prim: &Prim, name: &str) -> Result<Option<Vec<[f32; N]>>> {
        let Some(value) = self.value(prim, name)? else { return Ok(None) };
        let vectors = vectors(value);
        vectors.map(Some).ok_or_else(|| self.invalid(prim, format!("{name} is not an array of {N} numbers each")))
    }

    /// `answer` of the reader to a question about `prim`.
    fn ask<T, E: std::fmt::Debug + std::fmt::Display>(
        &self,
        prim: &Prim,
        answer: std::result::Result<T, E>,
    ) -> Result<T> {
        answer.map_err(|error| self.invalid(prim, format!("{error:#}")))
    }

    fn invalid(&self, prim: &Prim, what: impl Into<String>) -> Error {
        Error::invalid(self.path, prim.path().as_str(), what)
    }
}
