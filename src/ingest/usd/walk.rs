//! The prims of a stage that are seen, parents first, each with where it stands.

use glam::{DAffine3, DVec3};
use openusd::usd::Prim;

use super::{OpenedStage, xform};
use crate::error::{Error, Result};

/// So many prims are visited, or one for every 4 bytes of the file, each counted by its depth: references multiply what a
/// small file holds, and composing a prim takes longer the deeper it stands.
const MIN_WORK: usize = 1 << 15;

/// What a prim inherits.
#[derive(Clone)]
struct Inherited {
    /// The root's coordinates from the prim's.
    root_from_prim: DAffine3,
    /// Whether it is seen in final renders: its purpose is `default` or `render`.
    rendered: bool,
}

/// Whether what is below a prim is visited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Below {
    Visit,
    Skip,
}

/// Where a walk begins.
struct Root {
    /// What transforms lead to: those that reset the stack begin here.
    from: DAffine3,
    /// Whether prims must be defined and not abstract: those of a prototype need not.
    only_defined: bool,
}

impl OpenedStage<'_> {
    /// Calls `visit` for every prim that is defined, active, visible and rendered, parents first, children in order, with
    /// the stage's coordinates, in metres, from the prim's.
    pub fn walk(&self, mut visit: impl FnMut(&Prim, &DAffine3) -> Result<Below>) -> Result<()> {
        let root = Root { from: DAffine3::from_scale(DVec3::splat(self.metres_per_unit)), only_defined: true };
        let inherited = Inherited { root_from_prim: root.from, rendered: true };
        self.walk_from(&root, vec![(self.stage.prim("/"), inherited)], &mut visit)
    }

    /// The same for the prim `prototype` and those below it, with the coordinates that its own transform leads to; it need
    /// not be defined.
    pub fn walk_prototype(
        &self,
        prototype: Prim,
        visit: &mut dyn FnMut(&Prim, &DAffine3) -> Result<Below>,
    ) -> Result<()> {
        let root = Root { from: DAffine3::IDENTITY, only_defined: false };
        let above = Inherited { root_from_prim: root.from, rendered: true };
        let inherited = self.inherit(&root, &prototype, &above)?;
        self.walk_from(&root, inherited.map(|inherited| (prototype, inherited)).into_iter().collect(), visit)
    }

    fn walk_from(
        &self,
        root: &Root,
        mut pending: Vec<(Prim, Inherited)>,
        visit: &mut dyn FnMut(&Prim, &DAffine3) -> Result<Below>,
    ) -> Result<()> {
        let bytes = std::fs::metadata(self.path).map_err(|source| Error::read(self.path, source))?.len();
        let most = usize::try_from(bytes / 4).unwrap_or(usize::MAX).max(MIN_WORK);
        while let Some((parent, inherited)) = pending.pop() {
            // The pseudo-root has no content.
            let is_content = parent.path().as_str() != "/" && inherited.rendered;
            if is_content && visit(&parent, &inherited.root_from_prim)? == Below::Skip {
                continue;
            }
            let names = self.ask(&parent, parent.child_names())?;
            // The reader recurses without end over paths whose names hold braces.
            if let Some(name) = names.iter().find(|name| !name.chars().all(|c| c.is_alphanumeric() || c == '_')) {
                return Err(self.invalid(&parent, format!("'{name}' is no name for a prim")));
            }
            let children = self.ask(&parent, parent.children())?;
            for prim in children.into_iter().rev() {
                let work = self.work.get() + prim.path().as_str().matches('/').count();
                self.work.set(work);
                if work > most {
                    let what = format!("more prims than its size justifies, references counted, at {}", prim.path());
                    return Err(Error::unsupported(self.path, what));
                }
                if let Some(inherited) = self.inherit(root, &prim, &inherited)? {
                    pending.push((prim, inherited));
                }
            }
        }
        Ok(())
    }

    /// What `prim` passes on, or `None` if neither it nor what is below it is seen.
    fn inherit(&self, root: &Root, prim: &Prim, parent: &Inherited) -> Result<Option<Inherited>> {
        let drawn = self.ask(prim, prim.is_active())?
            && (!root.only_defined || self.ask(prim, prim.is_defined())? && !self.ask(prim, prim.is_abstract())?);
        if !drawn || self.token(prim, "visibility")?.as_deref() == Some("invisible") {
            return Ok(None);
        }
        let rendered = match self.token(prim, "purpose")?.as_deref() {
            None => parent.rendered,
            Some(purpose) => purpose == "default" || purpose == "render",
        };
        let (parent_from_prim, resets) = xform::local(self, prim)?;
        let root_from_prim = if resets { root.from } else { parent.root_from_prim } * parent_from_prim;
        if !root_from_prim.is_finite() {
            return Err(self.invalid(prim, "its transform is not finite"));
        }
        Ok(Some(Inherited { root_from_prim, rendered }))
    }
}
