//! Which material a prim is bound to (UsdShadeMaterialBindingAPI).
//!
//! A binding's purpose and collection are in the name of its relationship: material:binding[:purpose], or
//! material:binding:collection[:purpose]:name.

use std::collections::BTreeMap;
use std::rc::Rc;

use openusd::sdf::Path;
use openusd::usd::{Collection, MembershipQuery, Prim, is_collection_api_path};

use super::OpenedStage;
use super::values::name_of;
use crate::Result;

/// Purposes in the order in which they are asked: what final renders use, what has no purpose, what previews use.
pub const PURPOSES: [&str; 3] = ["full", "", "preview"];

/// The bindings of all prims asked for so far.
#[derive(Default)]
pub struct Bindings {
    authored: BTreeMap<String, Rc<Vec<Binding>>>,
}

/// A binding as a prim has it.
struct Binding {
    purpose: String,
    /// Which prims it holds for, where not for the prim and all below it.
    members: Option<MembershipQuery>,
    material: Path,
    stronger_than_descendants: bool,
}

impl Bindings {
    /// The material of `prim` for `purpose`: the nearest ancestor's, or the topmost that is stronger than its descendants;
    /// at one prim collections come before the direct binding.
    pub fn material(&mut self, stage: &OpenedStage, prim: &Prim, purpose: &str) -> Result<Option<Path>> {
        let mut winner = None;
        for path in prim.path().ancestors().take_while(|path| !path.is_abs_root()) {
            for binding in &*self.authored_on(stage, &path)? {
                let holds = binding.members.as_ref().is_none_or(|members| members.is_path_included(prim.path()));
                if binding.purpose == purpose && holds {
                    if winner.is_none() || binding.stronger_than_descendants {
                        winner = Some(binding.material.clone());
                    }
                    break;
                }
            }
        }
        Ok(winner)
    }

    fn authored_on(&mut self, stage: &OpenedStage, path: &Path) -> Result<Rc<Vec<Binding>>> {
        if let Some(authored) = self.authored.get(path.as_str()) {
            return Ok(authored.clone());
        }
        let prim = stage.stage.prim(path.clone());
        let mut bindings = Vec::new();
        for name in stage.ask(&prim, prim.property_names())? {
            bindings.extend(Binding::read(stage, &prim, name.as_ref())?);
        }
        bindings.sort_by_key(|binding: &Binding| binding.members.is_none());
        let bindings = Rc::new(bindings);
        self.authored.insert(path.as_str().to_owned(), bindings.clone());
        Ok(bindings)
    }
}

impl Binding {
    /// The binding that the property `name` of `prim` is, if it is one and has targets.
    fn read(stage: &OpenedStage, prim: &Prim, name: &str) -> Result<Option<Self>> {
        let parts: Vec<&str> = name.split(':').collect();
        let (purpose, of_collection) = match parts[..] {
            ["material", "binding"] => ("", false),
            ["material", "binding", "collection", purpose, _] => (purpose, true),
            ["material", "binding", "collection", ..] => ("", true),
            ["material", "binding", purpose] => (purpose, false),
            _ => return Ok(None),
        };
        let relationship = prim.relationship(name);
        let targets = stage.ask(prim, relationship.targets())?;
        let (members, material) = match (of_collection, &targets[..]) {
            (false, [material, ..]) => (None, material.clone()),
            (true, [collection, material]) => {
                let Some((owner, name)) = is_collection_api_path(collection) else { return Ok(None) };
                let collection = Collection::new(owner, name);
                (Some(stage.ask(prim, collection.compute_membership_query(&stage.stage))?), material.clone())
            }
            _ => return Ok(None),
        };
        let strength = stage.metadata(prim, relationship.path(), "bindMaterialAs")?.and_then(name_of);
        let stronger_than_descendants = strength.as_deref() == Some("strongerThanDescendants");
        Ok(Some(Self { purpose: purpose.to_owned(), members, material, stronger_than_descendants }))
    }
}
