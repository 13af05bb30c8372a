//! A BSDF of Mitsuba as something to fit to: another process evaluates it, and this one asks it in batches.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Mutex, OnceLock, PoisonError};

use anyhow::{Context, Result, bail};
use glimt_core::library::Origin;
use glimt_core::simd::{LANES, Lane3};
use glimt_core::{Brdf, Vec3};
use glimt_files::sha256;
use glimt_fit::{Input, Truth};
use serde::Deserialize;

/// The environment variable that names the Python to use.
pub const PYTHON: &str = "GLIMT_PYTHON";

/// A BSDF in a process of its own.
pub struct Simulated {
    name: String,
    anisotropic: bool,
    origin: Origin,
    pipe: Mutex<Pipe>,
    /// Why it gave no more values.
    failure: OnceLock<String>,
}

struct Pipe {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

/// The first line of the process.
#[derive(Deserialize)]
#[serde(untagged)]
enum Hello {
    Ready { name: String, anisotropic: bool },
    Failed { error: String },
}

impl Simulated {
    /// Starts `python3 -m glimt.simulate SCENE ID`.
    ///
    /// # Errors
    /// Python, Mitsuba or the package is not installed; the scene cannot be loaded or has no such BSDF.
    pub fn start(scene: &Path, bsdf: Option<&str>, command: &str) -> Result<Simulated> {
        if scene.to_str().is_none() {
            bail!("{} is no name in UTF-8, which Mitsuba needs", scene.display());
        }
        let python = python();
        let mut process = Command::new(&python);
        process.args(["-m", "glimt.simulate"]).arg(scene).args(bsdf);
        let mut child = process
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {} ({PYTHON} names another)", python.display()))?;
        let requests = child.stdin.take().context("no pipe to the simulation")?;
        let mut answers = BufReader::new(child.stdout.take().context("no pipe from the simulation")?);
        let mut line = String::new();
        answers.read_line(&mut line).context("the simulation answers no text")?;
        let (name, anisotropic) = match serde_json::from_str(&line) {
            Ok(Hello::Ready { name, anisotropic }) => (name, anisotropic),
            Ok(Hello::Failed { error }) => {
                bail!("{}", error.split_whitespace().collect::<Vec<_>>().join(" "))
            }
            Err(_) => {
                let status = child.wait()?;
                bail!(
                    "{} -m glimt.simulate ended with {status}; it needs the packages glimt and mitsuba, and \
                     {PYTHON} names another Python",
                    python.display()
                );
            }
        };
        let source = scene.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let sha256 = sha256(scene)?;
        let origin = Origin { source, sha256, command: command.to_owned(), ..Origin::default() };
        let pipe = Mutex::new(Pipe { child, requests, answers });
        Ok(Simulated { name, anisotropic, origin, pipe, failure: OnceLock::new() })
    }

    /// It as the input of a fit; isotropic unless it says otherwise, or `anisotropic` does.
    pub fn input(&self, anisotropic: bool) -> Input<'_> {
        Input {
            name: self.name.clone(),
            truth: Truth::Brdf(self),
            isotropic: !(self.anisotropic || anisotropic),
            origin: self.origin.clone(),
        }
    }

    /// Why there were no more values; every value since is 0.
    pub fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    fn ask(&self, pairs: impl Iterator<Item = (Vec3, Vec3)>, out: &mut [Vec3]) {
        if self.failure.get().is_some() {
            return out.fill(Vec3::ZERO);
        }
        let mut request = (out.len() as u32).to_le_bytes().to_vec();
        for (light, view) in pairs {
            request.extend(light.to_array().into_iter().chain(view.to_array()).flat_map(f32::to_le_bytes));
        }
        let mut answer = vec![0; size_of_val(out)];
        let mut pipe = self.pipe.lock().unwrap_or_else(PoisonError::into_inner);
        match pipe.ask(&request, &mut answer) {
            Ok(()) => {
                for (f, bytes) in out.iter_mut().zip(answer.chunks_exact(size_of::<Vec3>())) {
                    let number =
                        |i: usize| f32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
                    *f = Vec3::new(number(0), number(4), number(8));
                }
            }
            Err(reason) => {
                out.fill(Vec3::ZERO);
                let _ = self.failure.set(format!("the simulation of \"{}\" {reason}", self.name));
            }
        }
    }
}

/// Longest message of an exception that is passed on, in bytes.
const MOST_MESSAGE: u64 = 4096;

impl Pipe {
    /// Sends a request and fills `answer`.
    ///
    /// # Errors
    /// In words, what the BSDF threw, or how the process ended.
    fn ask(&mut self, request: &[u8], answer: &mut [u8]) -> Result<(), String> {
        let mut length = [0; 4];
        let asked = self.requests.write_all(request).and_then(|()| self.requests.flush());
        let answered = asked.and_then(|()| self.answers.read_exact(&mut length));
        let length = u32::from_le_bytes(length);
        if answered.is_ok() && length > 0 {
            let mut message = Vec::new();
            // A message that is cut short is better than none.
            let _ = self.answers.by_ref().take(u64::from(length).min(MOST_MESSAGE)).read_to_end(&mut message);
            return Err(format!("threw {}", String::from_utf8_lossy(&message)));
        }
        answered.and_then(|()| self.answers.read_exact(answer)).map_err(|error| match self.child.wait() {
            Ok(status) => format!("ended with {status}"),
            Err(_) => format!("ended: {error}"),
        })
    }
}

impl Brdf for Simulated {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        let mut f = [Vec3::ZERO];
        self.ask(std::iter::once((light, view)), &mut f);
        f[0]
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        let vector = |tile: &Lane3, lane: usize| Vec3::new(tile[0][lane], tile[1][lane], tile[2][lane]);
        let mut f = [Vec3::ZERO; LANES];
        self.ask((0..LANES).map(|lane| (vector(light, lane), vector(view, lane))), &mut f);
        for (c, channel) in out.iter_mut().enumerate() {
            for (value, f) in channel.iter_mut().zip(&f) {
                *value = f[c];
            }
        }
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        assert!(light.len() == out.len() && view.len() == out.len(), "as many lights as views and results");
        self.ask(light.iter().copied().zip(view.iter().copied()), out);
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        let pipe = self.pipe.get_mut().unwrap_or_else(PoisonError::into_inner);
        let _ = pipe.child.kill();
        let _ = pipe.child.wait();
    }
}

/// The Python to start: the one that the environment names, that of the environment in which this
/// command is installed, or the system's.
pub fn python() -> PathBuf {
    let beside =
        || Some(std::env::current_exe().ok()?.with_file_name("python3")).filter(|path| path.exists());
    let named = std::env::var_os(PYTHON).map(PathBuf::from);
    named.or_else(beside).unwrap_or_else(|| PathBuf::from("python3"))
}
