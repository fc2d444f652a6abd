//! Holds the import rule of the crate's map: a module imports only from modules above it in the list in `src/lib.rs`.

use std::path::{Path, PathBuf};

/// This stage may know every other one; the list above it is what the rule is about.
const FREE: &str = "pipeline";

fn source_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The modules in the order of the list in the crate's documentation, so that there is one source of the order.
fn stages(lib: &str) -> Vec<&str> {
    let list = lib.lines().skip_while(|line| *line != "//! ```text").skip(1);
    list.take_while(|line| *line != "//! ```").filter_map(|line| line[3..].split_whitespace().next()).collect()
}

/// First path segments of everything that `source` names through `crate::`, comments left out.
fn crate_paths(source: &str) -> Vec<String> {
    let code: String =
        source.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n");
    code.split("crate::")
        .skip(1)
        .flat_map(|rest| if rest.starts_with('{') { group(rest) } else { vec![word(rest)] })
        .collect()
}

fn word(text: &str) -> String {
    text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// First segments of `{a, b::{c, d}, e}`.
fn group(text: &str) -> Vec<String> {
    let mut depth = 0;
    let mut segments = Vec::new();
    for (i, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            break;
        }
        if depth == 1 && matches!(c, '{' | ',') {
            segments.push(word(&text[i + 1..]));
        }
    }
    segments.retain(|segment| !segment.is_empty());
    segments
}

/// What `source`, a file of `module`, imports from below itself.
fn violations(stages: &[&str], module: &str, source: &str) -> Vec<String> {
    let place = |name: &str| stages.iter().position(|stage| *stage == name);
    let own = place(module);
    let is_allowed = |name: &String| match name.as_str() {
        "Error" | "Result" => true,
        name => own.is_some() && place(name).is_some() && place(name) <= own,
    };
    crate_paths(source).into_iter().filter(|name| module != FREE && !is_allowed(name)).collect()
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries
        .flat_map(|path| if path.is_dir() { rust_files(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .collect();
    files.sort();
    files
}

/// The stage that a file under `src` belongs to: its first folder, or its own name.
fn module_of(file: &Path) -> String {
    let inside = file.strip_prefix(source_root()).unwrap().with_extension("");
    inside.iter().next().unwrap().to_str().unwrap().to_owned()
}

#[test]
fn stages_import_only_from_above() {
    let lib = std::fs::read_to_string(source_root().join("lib.rs")).unwrap();
    let stages = stages(&lib);
    let mut found = Vec::new();
    for file in rust_files(&source_root()) {
        let module = module_of(&file);
        // The command line tool is another crate on top of this one.
        if !["lib", "main", "cli"].contains(&module.as_str()) {
            assert!(stages.contains(&module.as_str()), "{} is of no stage in lib.rs's list", file.display());
            let source = std::fs::read_to_string(&file).unwrap();
            found.extend(
                violations(&stages, &module, &source).into_iter().map(|name| format!("{}: {name}", file.display())),
            );
        }
    }
    assert!(found.is_empty(), "imports from below:\n{}", found.join("\n"));
}

#[test]
fn the_list_names_every_module_in_the_order_of_declaration() {
    let lib = std::fs::read_to_string(source_root().join("lib.rs")).unwrap();
    let declared: Vec<_> =
        lib.lines().filter_map(|line| line.strip_prefix("pub mod ")).map(|rest| rest.trim_end_matches(';')).collect();
    assert_eq!(stages(&lib), declared);
}

#[test]
fn an_import_from_below_is_caught_in_every_form() {
    let stages = ["error", "scene", "trace", "bake", "pipeline"];
    let caught = |source: &str| violations(&stages, "trace", source);
    for source in [
        "use crate::bake::Progress;",
        "pub(crate) use crate::bake;",
        "    let x = crate::bake::run();",
        "use crate::{scene::{Scene, mesh}, bake};",
        "use crate::{\n    scene::Scene,\n    bake::Progress,\n};",
    ] {
        assert_eq!(caught(source), ["bake"], "{source}");
    }
    assert_eq!(caught("use crate::unlisted::X;"), ["unlisted"]);
    for source in
        ["use crate::scene::Scene;", "use crate::{Error, Result, scene};", "use crate::trace::Ray;", "// crate::bake"]
    {
        assert!(caught(source).is_empty(), "{source}");
    }
    assert!(violations(&stages, "pipeline", "use crate::bake;").is_empty());
}
