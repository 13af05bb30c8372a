//! Whether a library is what a fit would make again.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::ArgMatches;
use glimt_core::Library;
use glimt_files::{nbrdf, sha256, sha256_of};
use serde_json::json;

/// What the result of a fit follows from: the version, the options, and the contents of the files.
pub struct Recipe(String);

impl Recipe {
    /// The recipe of a fit to `files`, with the values of the options of these names.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn new<'a>(
        files: &[PathBuf],
        matches: &ArgMatches,
        options: impl Iterator<Item = &'a str>,
    ) -> Result<Recipe> {
        let values = |option: &'a str| {
            let raw = matches.get_raw(option)?;
            Some((option, raw.map(|value| value.to_string_lossy()).collect::<Vec<_>>()))
        };
        let options: BTreeMap<_, _> = options.filter_map(values).collect();
        let mut contents = Vec::new();
        for file in files.iter().flat_map(|file| nbrdf::parts(file)) {
            // Materials are named after their files.
            let name = file.file_name().map(|name| name.to_string_lossy().into_owned());
            contents.push((name, sha256(&file)?));
        }
        let recipe = json!([env!("CARGO_PKG_VERSION"), options, contents]);
        Ok(Recipe(sha256_of(recipe.to_string().as_bytes())))
    }

    /// The library, with a digest of this recipe and of all that the library holds: what was changed in the
    /// meantime, damaged or merged is told from what was fitted.
    ///
    /// # Errors
    /// Those of the library.
    pub fn stamp(&self, library: Library) -> Result<Library> {
        let library = library.with_digest(None);
        let digest = self.digest(&library)?;
        Ok(library.with_digest(Some(digest)))
    }

    /// The library at `path` if it follows from this recipe and is as it was written.
    pub fn find(&self, path: &Path) -> Option<Library> {
        let library = Library::open(path).ok()?;
        let expected = self.digest(&library.clone().with_digest(None)).ok()?;
        (library.digest() == Some(&expected)).then_some(library)
    }

    fn digest(&self, bare: &Library) -> Result<String> {
        let bytes = bare.to_bytes()?.unwrap_or_default();
        Ok(sha256_of(&[self.0.as_bytes(), &bytes].concat()))
    }
}
