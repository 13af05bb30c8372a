//! What was measured, kept by the content of what it was measured on.

use std::path::PathBuf;

use anyhow::{Context, Result};
use glimt_files::{sha256, sha256_of};
use glimt_report::study::Settings;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::output;

/// Raised whenever a measurement changes its meaning.
const VERSION: u32 = 2;

/// A directory of results.
pub struct Cache {
    directory: PathBuf,
    /// What every result depends on.
    common: Value,
}

impl Cache {
    /// The results that were measured like this.
    ///
    /// # Errors
    /// The directory cannot be made, or a map cannot be read.
    pub fn new(directory: PathBuf, settings: &Settings, maps: &[PathBuf]) -> Result<Cache> {
        std::fs::create_dir_all(&directory)
            .with_context(|| format!("cannot make the directory {}", directory.display()))?;
        let maps: Vec<String> = maps.iter().map(|map| sha256(map)).collect::<Result<_, _>>()?;
        let common = json!([VERSION, env!("CARGO_PKG_VERSION"), settings, maps]);
        Ok(Cache { directory, common })
    }

    /// What is kept under a key, or else what `measure` gives, which is kept from now on.
    ///
    /// # Errors
    /// Those of `measure`, or the result cannot be written.
    pub fn get<T: Serialize + DeserializeOwned>(
        &self,
        key: &Value,
        measure: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let name = sha256_of(json!([self.common, key]).to_string().as_bytes());
        let path = self.directory.join(format!("{name}.json"));
        // What cannot be read was written by something else: it is measured again.
        let kept = std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        if let Some(kept) = kept {
            return Ok(kept);
        }
        let measured = measure()?;
        output::write(&path, &serde_json::to_vec(&measured)?)?;
        Ok(measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_not_measured_again_unless_something_differs() {
        let folder = tempfile::tempdir().unwrap();
        let settings = |seed| Settings { seed, pairs: 1, size: 1, directions: 1, lights: Vec::new() };
        let open = |seed| Cache::new(folder.path().join("cache"), &settings(seed), &[]).unwrap();
        let get = |seed, key: &str, value: f64| open(seed).get(&json!(key), || Ok(value)).unwrap();
        assert_eq!(get(0, "a", 0.1), 0.1);
        assert_eq!(get(0, "a", 0.2), 0.1);
        assert_eq!(get(0, "b", 0.3), 0.3);
        assert_eq!(get(1, "a", 0.4), 0.4);
        for file in std::fs::read_dir(folder.path().join("cache")).unwrap() {
            std::fs::write(file.unwrap().path(), "{").unwrap();
        }
        assert_eq!(get(0, "a", 0.5), 0.5);
    }
}
