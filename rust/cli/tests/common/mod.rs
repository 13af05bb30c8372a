//! What the tests of the commands share: the process, a folder for its files, and small inputs.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::{Library, Material};
use glimt_files::Array;
use glimt_measured::utia::Encoding;
use tempfile::TempDir;

/// A folder with a library (`lib.safetensors` with the materials orange, mint and grey), a measurement
/// (`cloth.bin`) and `pairs.npy` with three pairs.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        let materials = [("orange", [0.6, 0.3, 0.1]), ("mint", [0.3, 0.7, 0.5]), ("grey", [0.2; 3])];
        let entries = materials.map(|(name, kd)| Entry {
            name: name.to_owned(),
            material: Material::from(ggx(kd)),
            origin: Origin { source: format!("{name}.bsdf"), ..Origin::default() },
        });
        Library::new(folder.path("lib.safetensors"), entries.to_vec()).unwrap().save().unwrap();
        glimt_measured::write_utia(folder.path("cloth.bin"), &ggx([0.5, 0.4, 0.3]), Encoding::default())
            .unwrap();
        folder.array(
            "pairs.npy",
            &[3, 6],
            &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, -0.6, 0.0, 0.8, 0.6, 0.0, 0.8, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0],
        );
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn array(&self, name: &str, shape: &[usize], values: &[f32]) {
        Array { shape: shape.to_vec(), values: values.to_vec() }.save(self.path(name)).unwrap();
    }

    /// Names of all files, sorted.
    pub fn files(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.0.path())
            .unwrap()
            .map(|file| file.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// The process in this folder, not started.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_glimt"));
        command.args(arguments).current_dir(self.0.path());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs a command that must succeed; its standard output.
    pub fn succeeds(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        assert!(stderr.is_empty(), "{arguments:?}: no progress where there is no terminal: {stderr}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a command that must succeed and warn; its standard output and its warnings.
    #[allow(dead_code, reason = "not every test binary warns")]
    pub fn warns(&self, arguments: &[&str]) -> (String, Vec<String>) {
        let output = self.run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        let warnings: Vec<String> = stderr.lines().map(str::to_owned).collect();
        assert!(!warnings.is_empty(), "{arguments:?}: no warning");
        assert!(warnings.iter().all(|line| line.starts_with("warning: ")), "{arguments:?}: {stderr}");
        (String::from_utf8(output.stdout).unwrap(), warnings)
    }

    /// Runs a command that must fail with this code, say one line, and leave the folder as it is;
    /// the line.
    pub fn fails(&self, code: i32, arguments: &[&str]) -> String {
        let before = self.files();
        let output = self.run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.starts_with("error: "), "{arguments:?}: {stderr}");
        if code == 1 {
            assert_eq!(stderr.lines().count(), 1, "{arguments:?}: {stderr}");
        }
        assert!(output.stdout.is_empty(), "{arguments:?}");
        assert_eq!(self.files(), before, "{arguments:?} left something behind");
        stderr
    }
}

pub fn ggx(kd: [f32; 3]) -> Ggx {
    Ggx::new(Microfacet { kd, eta: [1.5; 3], alpha: [0.3; 2] }).unwrap()
}

/// A file of the reference data, which is not part of the project: for tests that are ignored without it.
#[allow(dead_code, reason = "not every test binary reads one")]
pub fn shared(file: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(file);
    path.to_string_lossy().into_owned()
}
