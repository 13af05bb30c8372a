//! Where the models are listed for people, every model is in the list. (Where they are listed in code, the compiler
//! sees to it: matches over [`Kind`] have no wildcard.)

use std::path::Path;

use glimt_core::Kind;

/// A list of models: its file, and the texts between which it stands.
struct List {
    file: &'static str,
    from: &'static str,
    to: &'static str,
    /// What stands on either side of a model's name.
    quote: &'static str,
    /// Whether measured tables are in it.
    has_tables: bool,
}

const LISTS: [List; 2] = [
    List {
        file: "cpp/include/glimt/glimt.h",
        from: "The model of the library's materials as files",
        to: "*/",
        quote: "\"",
        has_tables: true,
    },
    List {
        file: "docs/guide/models.md",
        from: "| `--model` |",
        to: "Every model has",
        quote: "`",
        // They are no choice of `--model`; the guide on files has their formats.
        has_tables: false,
    },
];

impl List {
    fn text(&self) -> String {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(self.file);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let missing = |what| panic!("{} has no {what:?}: say in this test where its list is now", self.file);
        let (_, after) = text.split_once(self.from).unwrap_or_else(|| missing(self.from));
        let (list, _) = after.split_once(self.to).unwrap_or_else(|| missing(self.to));
        list.to_owned()
    }

    fn expected(&self) -> Vec<&'static str> {
        let is_listed = |kind: &Kind| *kind != Kind::Tabulated || self.has_tables;
        Kind::ALL.into_iter().filter(is_listed).map(Kind::name).collect()
    }
}

#[test]
fn every_list_of_models_is_complete() {
    let mut missing = Vec::new();
    for list in &LISTS {
        let text = list.text();
        for name in list.expected() {
            if !text.contains(&format!("{0}{name}{0}", list.quote)) {
                missing.push(format!("{}: {name}", list.file));
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
}
