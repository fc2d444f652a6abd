//! What the README says was measured stands on a page of docs/results, beside the command that measured it.

use std::path::Path;

/// The table rows of the README's section on measurements: figures, and the page that each row names.
fn rows(readme: &str) -> Vec<(Vec<String>, String)> {
    let section =
        readme.split("\n## ").find(|section| section.starts_with("Measured\n")).expect("a section 'Measured'");
    let rows = section.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| what"));
    rows.map(|row| {
        let (said, page) = row.split_once("](docs/results/").unwrap_or_else(|| panic!("no page is named: {row}"));
        let page = page.split([')', '#']).next().expect("a name").to_string();
        (figures(said), page)
    })
    .collect()
}

/// The numbers between asterisks: what was measured, not what was asked for.
fn figures(text: &str) -> Vec<String> {
    text.split("**").skip(1).step_by(2).map(|figure| figure.split(' ').next().unwrap_or("").to_string()).collect()
}

#[test]
fn every_figure_of_the_readme_stands_on_the_page_it_names_with_a_command() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let rows = rows(&readme);
    assert!(rows.len() >= 4, "{rows:?}");
    for (figures, page) in rows {
        let text =
            std::fs::read_to_string(root.join("docs/results").join(&page)).unwrap_or_else(|e| panic!("{page}: {e}"));
        assert!(text.contains("```sh\n"), "{page} names no command");
        assert!(!figures.is_empty(), "a row for {page} has no figure");
        for figure in figures {
            let words = text.split(|c: char| c.is_whitespace() || c == '|');
            assert!(words.into_iter().any(|word| word == figure), "{figure} is not on {page}");
        }
    }
}

#[test]
fn a_figure_without_a_source_is_found() {
    let readme = "# x\n\n## Measured\n\n| what | figure | page |\n|---|---|---|\n| a | **2.5 s** at 3 px | [x](docs/results/x.md) |\n\n## y\n";
    assert_eq!(rows(readme), [(vec!["2.5".to_string()], "x.md".to_string())]);
    let without = readme.replace("[x](docs/results/x.md)", "none");
    assert!(std::panic::catch_unwind(|| rows(&without)).is_err());
}
