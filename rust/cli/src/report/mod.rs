//! `glimt report`: models against measurements, in error and in cost.

mod cache;
mod fits;
mod frames;
mod opponents;
mod timing;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use glimt_core::simd::isa_name;
use glimt_disk::printable;
use glimt_fit::Net;
use glimt_image::exr::Exr;
use glimt_report::study::light::{Environment, Light};
use glimt_report::study::{Bench, Case, Made, Settings, Study, Subject};
use glimt_report::{Protocol, page, table};
use serde_json::json;

use crate::bench::report::{cpu, today};
use crate::fit::ModelName;
use crate::output::{Format, Overwrite};
use crate::values::parse_net;
use crate::{Usage, inputs, output};
use cache::Cache;
use opponents::{Opponents, Truth};

/// Report error against run time and memory: tables, plots and a page
///
/// FILE are measurements and model libraries fitted to them, whose materials are matched by name; --models fits what
/// is not fitted yet. Where there are measurements, NBRDF weights are models of them; where there are none, NBRDF
/// weights and published analytic fits are what libraries are held against. Errors of f are over pairs of directions
/// in both orders, grazing ones apart; errors of images are of spheres under several lights, lit by the core; times are of
/// one core. What is measured is kept in the directory by the content of the files: an interrupted report goes on
/// where it was, and a new model is added without the others being measured again.
#[derive(clap::Args)]
pub struct Arguments {
    /// Measurements, and model libraries fitted to them; directories and globs of them
    #[arg(required = true, value_name = "FILE", value_parser = inputs::file())]
    files: Vec<PathBuf>,
    /// Directory to write: index.html, report.csv, report.json, plots and fitted libraries
    #[arg(short, long, value_name = "DIRECTORY", value_parser = inputs::file())]
    output: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Models to fit to the measurements, as glimt fit does by default
    #[arg(long, value_enum, value_name = "MODEL", value_delimiter = ',')]
    models: Vec<ModelName>,
    /// Sizes of the networks of those models that have one [default: as glimt fit]
    #[arg(long, value_name = "WxN", value_parser = parse_net, value_delimiter = ',', requires = "models")]
    sizes: Vec<Net>,
    /// Steps of the fits of those models [default: as glimt fit]
    #[arg(long, value_name = "N", requires = "models")]
    steps: Option<u64>,
    /// Environment maps to light spheres with besides lamps and studio (OpenEXR, latitude and longitude)
    #[arg(long, value_name = "MAP.exr", value_parser = inputs::file())]
    envmap: Vec<PathBuf>,
    /// Pairs of directions of errors in BRDF space; at the default, those that published figures were measured on
    #[arg(long, value_name = "N", default_value_t = Protocol::PAIRS as u32, value_parser = clap::value_parser!(u32).range(1000..=100_000_000))]
    pairs: u32,
    /// Pixels across the spheres
    #[arg(long, value_name = "PIXELS", default_value_t = 96, value_parser = clap::value_parser!(u16).range(16..=1024))]
    size: u16,
    /// Directions a pixel
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    spp: u32,
    /// Render whole frames of this material in Mitsuba, too: work precision of every model. Needs Python with mitsuba
    /// and glimt
    #[arg(long, value_name = "MATERIAL")]
    frames: Option<String>,
    /// Rounds of timing, of which there is the median
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u16).range(1..))]
    rounds: u16,
    /// Seed of the random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
}

/// The files that are written under names of their own.
const TEXTS: [(&str, Format); 3] =
    [("index.html", Format::Page), ("report.csv", Format::Csv), ("report.json", Format::Json)];

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let directory = &arguments.output;
    let create = |path: &Path| {
        std::fs::create_dir_all(path).with_context(|| format!("cannot make the directory {}", path.display()))
    };
    create(directory)?;
    create(&directory.join("plots"))?;
    // What is kept here is read and written by one report at a time.
    let _claim = output::claim(directory)?;
    let mut outputs = fits::libraries(arguments);
    for (name, format) in TEXTS {
        let path = directory.join(name);
        arguments.overwrite.check(&path, format)?;
        outputs.push(path);
    }
    let outputs: Vec<&Path> = outputs.iter().map(PathBuf::as_path).collect();
    let lights = lights(&arguments.envmap)?;
    let settings = Settings {
        seed: arguments.seed,
        pairs: arguments.pairs as usize,
        size: arguments.size.into(),
        directions: arguments.spp as usize,
        lights: lights.iter().map(|light| light.name().to_owned()).collect(),
    };
    let mut opponents = Opponents::new(&inputs::open(&arguments.files, &outputs)?)?;
    for fitted in fits::fit(arguments, &opponents.truths)? {
        opponents.add(fitted)?;
    }
    if opponents.models.is_empty() {
        let message =
            "there is no model to report on; give fitted libraries beside the measurements, or --models";
        return Err(Usage(message.into()).into());
    }
    let cache = Cache::new(directory.join("cache"), &settings, &arguments.envmap)?;
    let subjects = measure(&opponents, &lights, &settings, &cache)?;
    let frames =
        arguments.frames.as_ref().map(|name| frames::render(&opponents, name, &cache)).transpose()?;
    let study = Study {
        made: made(),
        settings,
        candidates: timing::candidates(&opponents, arguments.rounds),
        subjects,
        frames,
    };
    write(directory, &study)
}

/// The lamps, the studio, and the maps.
fn lights(maps: &[PathBuf]) -> Result<Vec<Light>> {
    let mut lights = vec![Light::lamps(), Light::studio()];
    for path in maps {
        let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        if lights.iter().any(|light| light.name() == name) {
            return Err(Usage(format!("two lights are named \"{name}\"")).into());
        }
        lights.push(Light::Environment(Environment::new(name, &Exr::open(path, "")?)?));
    }
    Ok(lights)
}

/// Measures every material and every model of it, or takes what was kept.
fn measure(
    opponents: &Opponents,
    lights: &[Light],
    settings: &Settings,
    cache: &Cache,
) -> Result<Vec<Subject>> {
    let work = opponents.truths.iter().map(|truth| 1 + opponents.against(truth).count()).sum();
    let bar = output::progress_bar(work, "measure");
    let mut subjects = Vec::new();
    for truth in &opponents.truths {
        // Its directions and images are made only if something is to be measured with them.
        let mut bench = None;
        let key = json!([truth.sha256, truth.name]);
        let mut subject: Subject =
            cache.get(&key, || Ok(open(&mut bench, truth, lights, settings)?.subject(lights)?))?;
        subject.name.clone_from(&truth.name);
        subject.file = truth.file.display().to_string();
        subject.sha256.clone_from(&truth.sha256);
        subject.format = truth.format.to_owned();
        bar.inc(1);
        for (model, entry) in opponents.against(truth) {
            let key = json!([truth.sha256, truth.name, model.sha256, entry.name]);
            let mut case: Case = cache.get(&key, || {
                Ok(open(&mut bench, truth, lights, settings)?.case(&model.name, &entry.material)?)
            })?;
            case.candidate.clone_from(&model.name);
            subject.cases.push(case);
            bar.inc(1);
        }
        subjects.push(subject);
    }
    bar.finish_and_clear();
    Ok(subjects)
}

fn open<'a, 'b>(
    bench: &'b mut Option<Bench<'a>>,
    truth: &'a Truth,
    lights: &[Light],
    settings: &'a Settings,
) -> Result<&'b Bench<'a>> {
    if bench.is_none() {
        *bench = Some(Bench::new(&truth.material, lights, settings)?);
    }
    Ok(bench.as_ref().expect("it was just made"))
}

fn made() -> Made {
    let quoted = |word: String| if word.contains(' ') { format!("\"{word}\"") } else { word };
    let words = ["glimt".to_owned()].into_iter().chain(inputs::words().map(quoted));
    Made {
        command: words.collect::<Vec<_>>().join(" "),
        glimt: env!("CARGO_PKG_VERSION").to_owned(),
        cpu: cpu(),
        instruction_set: isa_name().to_owned(),
        date: today(),
    }
}

fn write(directory: &Path, study: &Study) -> Result<()> {
    let texts = [page::html(study), table::csv(study), table::json(study)];
    for ((name, _), text) in TEXTS.iter().zip(&texts) {
        output::write(&directory.join(name), text.as_bytes())?;
    }
    for plot in page::plots(study) {
        output::write(&directory.join(format!("plots/{}.svg", plot.name)), plot.file(study).as_bytes())?;
    }
    output::print(&table::text(study))?;
    output::print(&format!("\n{}\n", printable(&directory.join("index.html").display().to_string())))
}
