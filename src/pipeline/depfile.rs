//! All inputs of a bake as a rule of Make, which Ninja reads as well (`depfile`, `deps = gcc`).

use std::io::Write;
use std::path::Path;

use crate::Result;
use crate::encode::file::write_bytes_atomically;

/// Writes to `path` that `target` depends on `files`.
pub(super) fn write<'a>(path: &Path, target: &Path, files: impl Iterator<Item = &'a Path>) -> Result<()> {
    let rule = rule(target, files);
    write_bytes_atomically(path, |file| file.write_all(rule.as_bytes()))
}

fn rule<'a>(target: &Path, files: impl Iterator<Item = &'a Path>) -> String {
    let names: Vec<String> = files.map(escaped).collect();
    // A rule without a recipe for each, as `gcc -MP` writes them: Make then does not stop at a file that was removed.
    let phony: String = names.iter().map(|name| format!("\n{name}:\n")).collect();
    format!("{}: \\\n  {}\n{phony}", escaped(target), names.join(" \\\n  "))
}

/// A path as GCC writes it, which both read: backslashes before spaces and hashes (one that stands there already is
/// doubled), dollars doubled.
fn escaped(path: &Path) -> String {
    let mut text = String::new();
    let mut backslashes = 0;
    for letter in path.to_string_lossy().chars() {
        match letter {
            ' ' | '\t' => text.extend(std::iter::repeat_n('\\', backslashes + 1)),
            '#' => text.push('\\'),
            '$' => text.push('$'),
            _ => {}
        }
        text.push(letter);
        backslashes = if letter == '\\' { backslashes + 1 } else { 0 };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn special_letters_are_escaped_as_gcc_does() {
        let pairs = [
            ("a/b.ply", "a/b.ply"),
            ("my room.ply", "my\\ room.ply"),
            ("a\\ b", "a\\\\\\ b"),
            ("#1 $x", "\\#1\\ $$x"),
            ("C:\\x", "C:\\x"),
        ];
        for (path, expected) in pairs {
            assert_eq!(escaped(Path::new(path)), expected);
        }
    }

    #[test]
    fn a_rule_names_its_target_first_and_every_file_twice() {
        let files = ["a.ply", "b c.glb"].map(Path::new);
        let expected = "out/manifest.json: \\\n  a.ply \\\n  b\\ c.glb\n\na.ply:\n\nb\\ c.glb:\n";
        assert_eq!(rule(Path::new("out/manifest.json"), files.into_iter()), expected);
    }
}
