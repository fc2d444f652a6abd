//! A job as a JSON file.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::{Background, Job, Preset};
use crate::{Error, Result};

impl Job {
    /// Reads a job file (schemas/job.schema.json); relative paths in it become relative to its folder.
    ///
    /// What the file does not state comes from `preset` or, without one, from the file's own.
    ///
    /// Fails when the file cannot be read, or is not a job: the error then names line and column. What the values
    /// mean together is [`Job::validate`]'s to check.
    pub fn from_file(path: &Path, preset: Option<Preset>) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::read(path, source))?;
        let broken = |error: serde_json::Error| {
            Error::invalid(path, format!("{}:{}", error.line(), error.column()), without_position(&error))
        };
        let stated: Self = serde_json::from_str(&text).map_err(broken)?;
        let preset = preset.unwrap_or(stated.preset);
        let mut job = if preset == Preset::default() { stated } else { on_top_of(preset, &text).map_err(broken)? };
        job.preset = preset;
        let folder = path.parent().unwrap_or(Path::new(""));
        let inputs = job.splats.iter_mut().map(|input| &mut input.path);
        let inputs = inputs.chain(job.meshes.iter_mut().map(|input| &mut input.path));
        let background = match &mut job.background {
            Background::Map(path) => Some(path),
            Background::Colour(_) => None,
        };
        let outputs = [&mut job.output, &mut job.stats, &mut job.cache, &mut job.depfile, &mut job.placement.placed];
        for path in inputs.chain(background).chain(outputs.into_iter().flatten()) {
            resolve(folder, path);
        }
        job.file = Some(path.to_owned());
        Ok(job)
    }
}

/// The job of `preset`, with all that `text` states instead.
fn on_top_of(preset: Preset, text: &str) -> serde_json::Result<Job> {
    let stated: Map<String, Value> = serde_json::from_str(text)?;
    let mut fields: Map<String, Value> = serde_json::from_value(serde_json::to_value(preset.job())?)?;
    fields.extend(stated);
    serde_json::from_value(Value::Object(fields))
}

/// `Path::join` keeps an absolute path as it is.
fn resolve(folder: &Path, path: &mut PathBuf) {
    *path = folder.join(&*path);
}

/// serde_json ends its messages with the position that the error states already.
fn without_position(error: &serde_json::Error) -> String {
    let message = error.to_string();
    match message.rsplit_once(" at line ") {
        Some((what, _)) => what.to_owned(),
        None => message,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> (PathBuf, Result<Job>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.json");
        std::fs::write(&path, text).unwrap();
        (folder.path().to_owned(), Job::from_file(&path, None))
    }

    #[test]
    fn relative_paths_are_relative_to_the_job_file_and_absolute_ones_stay() {
        let (folder, job) = load(
            r#"{"splats": [{"path": "a/b.ply"}], "meshes": [{"path": "/m.glb"}], "output": "out", "stats": "s.json"}"#,
        );
        let job = job.unwrap();
        assert_eq!(job.splats[0].path, folder.join("a/b.ply"));
        assert_eq!(job.meshes[0].path, PathBuf::from("/m.glb"));
        assert_eq!(job.output, Some(folder.join("out")));
        assert_eq!(job.stats, Some(folder.join("s.json")));
    }

    #[test]
    fn an_unknown_field_is_an_error_that_names_it_with_line_and_column() {
        let message = load("{\n  \"faceSice\": 64\n}").1.unwrap_err().to_string();
        assert!(message.contains("job.json: 2:12: unknown field `faceSice`"), "{message}");
        assert!(!message.contains("at line"), "{message}");
    }

    #[test]
    fn a_cut_off_file_is_an_error_and_an_absent_one_another() {
        assert!(matches!(load("{").1, Err(Error::Invalid { .. })));
        assert!(matches!(Job::from_file(Path::new("absent.json"), None), Err(Error::Read { .. })));
    }

    #[test]
    fn what_a_file_states_wins_over_any_preset_and_a_flag_over_the_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.json");
        std::fs::write(&path, r#"{"preset": "draft", "faceSize": 99, "placement": {"grid": [1, 2, 3]}}"#).unwrap();
        let draft = Job::from_file(&path, None).unwrap();
        let expected =
            Job { face_size: 99, placement: draft.placement.clone(), file: Some(path.clone()), ..Preset::Draft.job() };
        assert_eq!(draft, expected);
        assert_eq!(draft.placement.grid, Some([1, 2, 3]));
        let reference = Job::from_file(&path, Some(Preset::Reference)).unwrap();
        assert_eq!((reference.face_size, reference.samples), (99, Preset::Reference.job().samples));
        // Even back to what the standard is.
        std::fs::write(&path, r#"{"preset": "draft", "faceSize": 256}"#).unwrap();
        assert_eq!(Job::from_file(&path, None).unwrap().face_size, 256);
        assert_eq!(Preset::Standard.job(), Job::default());
    }

    #[test]
    fn a_job_survives_its_own_json() {
        let text = r#"{"splats": [{"path": "/a.ply", "frame": "rdf", "encoding": "lin-scene"}], "faceSize": 64,
            "placement": {"probes": [[1, 2, 3]]}, "threads": 3, "order": "cameraDistance"}"#;
        let job = Job { file: None, ..load(text).1.unwrap() };
        assert_eq!(serde_json::from_str::<Job>(&serde_json::to_string(&job).unwrap()).unwrap(), job);
    }
}
