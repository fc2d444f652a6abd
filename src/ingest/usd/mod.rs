//! USD stages (.usda, .usdc, .usdz): opened, walked, and closed again, on a thread of their own.
//!
//! The `openusd` crate composes the layers. It knows no schemas, so that fallback values are written down here, and it
//! trusts its input, so that layers are checked before they get there ([`resolver`], [`crate_check`]) and a panic of the
//! crate is an error of the file.

mod crate_check;
mod resolver;
mod splats;
mod xform;

use std::path::Path;

use glam::DAffine3;
use openusd::sdf::Value;
use openusd::usd::{Prim, Stage, TimeCode};

use self::resolver::{FolderResolver, PACKAGE_MAGIC};
use crate::error::{Error, Result};
use crate::job::Frame;

pub(super) use splats::open_splats;

/// The reader recurses over composition arcs and namespaces.
const STACK_BYTES: usize = 256 << 20;

/// So many prims are visited, or one for every 4 bytes of the file, each counted by its depth: references multiply what a
/// small file holds, and composing a prim takes longer the deeper it stands.
const MIN_WORK: usize = 1 << 15;

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
}

/// What a prim inherits.
#[derive(Clone)]
struct Inherited {
    /// The stage's coordinates, in metres, from the prim's.
    file_from_prim: DAffine3,
    /// Whether it is seen in final renders: its purpose is `default` or `render`.
    rendered: bool,
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
        let stage = Stage::builder().resolver(resolver).open(name);
        let stage = stage.map_err(|error| Error::invalid(path, "stage", format!("{error:#}")))?;
        // What is left out silently would be missing in the bake.
        if let Some(error) = stage.composition_errors().first() {
            return Err(Error::invalid(path, "stage", error.to_string()));
        }
        let metadata =
            |name: &str| stage.stage_metadata(name).map_err(|error| Error::invalid(path, name, format!("{error:#}")));
        // Without one a stage is in centimetres (UsdGeomLinearUnits).
        let metres_per_unit = match metadata("metersPerUnit")? {
            None => 0.01,
            Some(value) => xform::numbers(&value).filter(|it| it.len() == 1).map_or(f64::NAN, |it| it[0]),
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
        Ok(Self { path, stage, metres_per_unit, frame })
    }

    /// Calls `visit` for every prim that is defined, active, visible and rendered, parents first, children in order.
    fn walk(&self, mut visit: impl FnMut(&Prim, &DAffine3) -> Result<()>) -> Result<()> {
        let metres = DAffine3::from_scale(glam::DVec3::splat(self.metres_per_unit));
        let root = Inherited { file_from_prim: metres, rendered: true };
        let mut pending = vec![(self.stage.prim("/"), root)];
        let bytes = std::fs::metadata(self.path).map_err(|source| Error::read(self.path, source))?.len();
        let most = usize::try_from(bytes / 4).unwrap_or(usize::MAX).max(MIN_WORK);
        let mut work = 0;
        while let Some((parent, inherited)) = pending.pop() {
            let names = self.ask(&parent, parent.child_names())?;
            // The reader recurses without end over paths whose names hold braces.
            if let Some(name) = names.iter().find(|name| !name.chars().all(|c| c.is_alphanumeric() || c == '_')) {
                return Err(self.invalid(&parent, format!("'{name}' is no name for a prim")));
            }
            let children = self.ask(&parent, parent.children())?;
            for prim in children.into_iter().rev() {
                work += prim.path().as_str().matches('/').count();
                if work > most {
                    let what = format!("more prims than its size justifies, references counted, at {}", prim.path());
                    return Err(Error::unsupported(self.path, what));
                }
                if let Some(inherited) = self.inherit(&prim, &inherited)? {
                    pending.push((prim, inherited));
                }
            }
            // The pseudo-root has no content, and its own children are on the stack above it.
            if parent.path().as_str() != "/" && inherited.rendered {
                visit(&parent, &inherited.file_from_prim)?;
            }
        }
        Ok(())
    }

    /// What `prim` passes on, or `None` if neither it nor what is below it is seen.
    fn inherit(&self, prim: &Prim, parent: &Inherited) -> Result<Option<Inherited>> {
        let drawn = self.ask(prim, prim.is_active())?
            && self.ask(prim, prim.is_defined())?
            && !self.ask(prim, prim.is_abstract())?;
        if !drawn || self.token(prim, "visibility")?.as_deref() == Some("invisible") {
            return Ok(None);
        }
        let rendered = match self.token(prim, "purpose")?.as_deref() {
            None => parent.rendered,
            Some(purpose) => purpose == "default" || purpose == "render",
        };
        let (parent_from_prim, resets) = xform::local(self, prim)?;
        let from =
            if resets { DAffine3::from_scale(glam::DVec3::splat(self.metres_per_unit)) } else { parent.file_from_prim };
        let file_from_prim = from * parent_from_prim;
        if !file_from_prim.is_finite() {
            return Err(self.invalid(prim, "its transform is not finite"));
        }
        Ok(Some(Inherited { file_from_prim, rendered }))
    }

    /// The value of an attribute: its default, else its first time sample. A blocked value is none.
    fn value(&self, prim: &Prim, name: &str) -> Result<Option<Value>> {
        let attribute = prim.attribute(name);
        let mut value = self.ask(prim, attribute.get::<Value>())?;
        if value.is_none()
            && let Some(&first) = self.ask(prim, attribute.time_sample_times())?.first()
        {
            value = self.ask(prim, attribute.get_at::<Value>(TimeCode::new(first)))?;
        }
        Ok(value.filter(|value| !matches!(value, Value::ValueBlock | Value::None)))
    }

    fn token(&self, prim: &Prim, name: &str) -> Result<Option<String>> {
        match self.value(prim, name)? {
            None => Ok(None),
            Some(Value::Token(token)) => Ok(Some(token.to_string())),
            Some(_) => Err(self.invalid(prim, format!("{name} is not a token"))),
        }
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
