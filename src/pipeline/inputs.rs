//! What a scene is made of, by content: known without reading it where its files are as they were.
//!
//! Which files an input names is known only to its reader. So they are kept under the hash of the inputs themselves, and
//! the scene's key is the hash of all of them: of a changed list the old one's hashes differ, because some listed file has
//! changed, or the input itself.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use bytemuck::cast_slice;
use serde::{Deserialize, Serialize};

use super::memory::Memory;
use crate::bake::Cubemap;
use crate::bvh::MESH_LANES;
use crate::cache::{Bundle, Digest, Digests, Key};
use crate::ingest::{self, SceneReport};
use crate::job::{Background, Job, Placement};
use crate::place::Probe;
use crate::{Error, Result};

/// The inputs that a job names.
pub(super) struct Inputs<'a> {
    job: &'a Job,
    /// The job as far as it decides the result.
    settings: Job,
    /// The files of `job.splats` and then `job.meshes`.
    named: Vec<PathBuf>,
    /// Other files: the background's image, and the manifest with the probes.
    others: Vec<PathBuf>,
    digests: BTreeMap<PathBuf, Option<Digest>>,
    key: Key,
}

/// The files of each of a scene report's entries.
#[derive(Serialize, Deserialize)]
struct Sources {
    splats: Vec<Source>,
    meshes: Vec<Source>,
}

/// The files of a report.
#[derive(Serialize, Deserialize)]
struct Source {
    /// Which of the named inputs.
    input: usize,
    /// Relative to that input's folder where they are in it.
    files: Vec<PathBuf>,
}

/// A scene by content.
pub(super) struct Content {
    /// Everything in and around the scene.
    pub scene: Key,
    /// The light around it.
    pub background: Key,
    /// The manifest that the job's probes are taken from.
    pub placed: Key,
    pub splats: Key,
    /// As many as the tree tells apart.
    pub meshes: Vec<Key>,
    /// Every file that was read, or looked for.
    digests: BTreeMap<PathBuf, Option<Digest>>,
}

impl<'a> Inputs<'a> {
    /// The inputs of `job`. Fails with [`Error::Read`] for one that cannot be read.
    pub fn new(job: &'a Job, digests: &Digests) -> Result<Self> {
        let splats = job.splats.iter().map(|input| ingest::index_file(&input.path));
        let named: Vec<PathBuf> = splats.chain(job.meshes.iter().map(|input| input.path.clone())).collect();
        let background = match &job.background {
            Background::Map(path) => Some(path.clone()),
            Background::Colour(_) => None,
        };
        let others: Vec<PathBuf> = background.into_iter().chain(job.placement.placed.clone()).collect();
        let mut own = BTreeMap::new();
        for path in named.iter().chain(&others) {
            own.insert(path.clone(), Some(digests.of(path)?));
        }
        let settings = job.result_settings();
        let contents: Vec<&Option<Digest>> = named.iter().map(|path| &own[path]).collect();
        let key = Key::of("inputs", &(&settings.splats, &settings.meshes, contents));
        Ok(Self { job, settings, named, others, digests: own, key })
    }

    /// The scene, if these inputs have been read before.
    pub fn recall(&self, memory: &Memory, digests: &Digests) -> Result<Option<Content>> {
        let sources: Option<Sources> = memory.get(&self.key).and_then(|bundle| bundle.get_json("sources"));
        sources.map(|sources| self.content(&sources, digests)).transpose()
    }

    /// The scene that was read since `begun` with this `report`.
    ///
    /// Fails with [`Error::Changed`] where a file was written meanwhile.
    pub fn learn(
        &self,
        report: &SceneReport,
        begun: SystemTime,
        memory: &Memory,
        digests: &Digests,
    ) -> Result<Content> {
        let sources = Sources {
            splats: report.splats.iter().map(|report| self.source(&report.path, &report.files)).collect(),
            meshes: report.meshes.iter().map(|report| self.source(&report.path, &report.files)).collect(),
        };
        let content = self.content(&sources, digests)?;
        content.check(digests)?;
        // Files that nobody knew of are hashed only now. A clock that runs ahead must not make every file seem new.
        let now = SystemTime::now();
        for path in content.digests.keys().filter(|path| !self.digests.contains_key(*path)) {
            let modified = path.metadata().and_then(|metadata| metadata.modified());
            if modified.is_ok_and(|modified| (begun..now).contains(&modified)) {
                return Err(Error::Changed { path: path.clone() });
            }
        }
        let mut bundle = Bundle::default();
        bundle.add_json("sources", &sources);
        memory.put(&self.key, &bundle);
        Ok(content)
    }

    fn source(&self, path: &Path, files: &[PathBuf]) -> Source {
        let mut paths =
            self.job.splats.iter().map(|input| &input.path).chain(self.job.meshes.iter().map(|input| &input.path));
        let input = paths.position(|named| named == path).unwrap_or(0);
        let folder = self.folder(input);
        let inside = |file: &PathBuf| {
            let file = file.canonicalize().unwrap_or_else(|_| file.clone());
            file.strip_prefix(&folder).map(Path::to_owned).unwrap_or(file)
        };
        Source { input, files: files.iter().map(inside).collect() }
    }

    /// The folder of an input, where its own file is: formats read nothing outside of it.
    fn folder(&self, input: usize) -> PathBuf {
        let file = self.named.get(input).map(|path| path.canonicalize().unwrap_or_else(|_| path.clone()));
        file.as_deref().and_then(Path::parent).unwrap_or(Path::new("")).to_owned()
    }

    fn content(&self, sources: &Sources, digests: &Digests) -> Result<Content> {
        let (settings, job) = (&self.settings, self.job);
        let mut all = self.digests.clone();
        let mut states = |source: &Source| -> Result<Vec<(PathBuf, Option<Digest>)>> {
            let folder = self.folder(source.input);
            let own = self.named.get(source.input);
            let state = |file: &PathBuf| {
                let path = folder.join(file);
                let is_own = own.is_some_and(|own| own.canonicalize().is_ok_and(|own| own == path));
                let path = own.filter(|_| is_own).cloned().unwrap_or(path);
                let digest = digests.of_existing(&path)?;
                all.insert(path, digest.clone());
                Ok((file.clone(), digest))
            };
            source.files.iter().map(state).collect()
        };
        let splat_files = sources.splats.iter().map(&mut states).collect::<Result<Vec<_>>>()?;
        let mesh_files = sources.meshes.iter().map(&mut states).collect::<Result<Vec<_>>>()?;
        // What no list names follows the input of the other list that brought it.
        let from_meshes = (splat_files.len() > job.splats.len()).then_some(&settings.meshes);
        let splats = Key::of("splats", &(&settings.splats, from_meshes, splat_files));
        let mesh = |(i, files): (usize, &Vec<(PathBuf, Option<Digest>)>)| match settings.meshes.get(i) {
            Some(input) => Key::of("mesh", &(input, files)),
            None => Key::of("mesh", &(&settings.splats, files)),
        };
        let mut meshes: Vec<Key> = mesh_files.iter().enumerate().map(mesh).collect();
        if meshes.len() > MESH_LANES {
            let rest = meshes.split_off(MESH_LANES - 1);
            meshes.push(Key::of("meshes", &rest));
        }
        let other = |path: Option<&PathBuf>| path.map(|path| self.digests[path].clone());
        let map = self.others.first().filter(|_| matches!(job.background, Background::Map(_)));
        let background = Key::of("background", &(&settings.background, other(map)));
        let placed = Key::of("placed", &other(job.placement.placed.as_ref()));
        let scene = Key::of("scene", &(splats, &meshes, background));
        Ok(Content { scene, background, placed, splats, meshes, digests: all })
    }
}

impl Content {
    /// Fails with [`Error::Changed`] where a file is not what it was.
    pub fn check(&self, digests: &Digests) -> Result<()> {
        for (path, expected) in &self.digests {
            if digests.of_existing(path)? != *expected {
                return Err(Error::Changed { path: path.clone() });
            }
        }
        Ok(())
    }

    /// The key of `probe`, baked as `job` says.
    pub fn probe_key(&self, job: &Job, probe: &Probe) -> Key {
        Key::of("probe", &(self.scene, look(job), probe))
    }

    /// The digest of an input that the job names.
    pub fn digest(&self, path: &Path) -> Option<&Digest> {
        self.digests.get(path)?.as_ref()
    }

    /// Every file that the result depends on.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.digests.iter().filter(|(_, digest)| digest.is_some()).map(|(path, _)| path.as_path())
    }
}

/// The key of the files that the light traced for `probe` becomes, whatever it was traced in.
pub(super) fn files_key(job: &Job, probe: &Probe, cubemap: &Cubemap) -> Key {
    let mut light = blake3::Hasher::new();
    light.update(cast_slice(&cubemap.texels));
    if let Some(distance) = &cubemap.distance {
        light.update(cast_slice(distance));
    }
    Key::of("files", &(look(job), probe, light.finalize().as_bytes()))
}

/// What of `job` decides a probe's pixels and files, beside the scene: inputs are known by content, and where the other
/// probes stand does not matter.
fn look(job: &Job) -> Job {
    Job { splats: Vec::new(), meshes: Vec::new(), placement: Placement::default(), ..job.result_settings() }
}
