//! How long each model takes.

use glimt_report::study::{Candidate, Time};
use rayon::ThreadPoolBuilder;

use super::opponents::{Model, Opponents};
use crate::bench::cases::Case;
use crate::bench::report::quantile;
use crate::bench::ways::{Way, Workspace};

/// The models of a report with their costs. The first material of each stands for all: time hardly depends on
/// the material. Rounds alternate between all models and ways, so that what else the machine does meets all.
pub fn candidates(opponents: &Opponents, rounds: u16) -> Vec<Candidate> {
    let models = &opponents.models;
    let mut workspace = Workspace::new();
    let mut times = vec![vec![Vec::new(); Way::ALL.len()]; models.len()];
    let one_core = ThreadPoolBuilder::new().num_threads(1).build().expect("one thread can be started");
    // The first round only warms caches and clock.
    for round in 0..=rounds {
        for (model, times) in models.iter().zip(&mut times) {
            for (way, times) in Way::ALL.into_iter().zip(times) {
                let seconds = one_core.install(|| way.seconds(&model.entries[0].material, &mut workspace));
                if round > 0 {
                    times.push(1e9 * seconds);
                }
            }
        }
    }
    models.iter().zip(times).map(|(model, times)| candidate(model, &times)).collect()
}

fn candidate(model: &Model, times: &[Vec<f64>]) -> Candidate {
    let time = |(way, ns): (Way, &Vec<f64>)| {
        let time = Time { median: quantile(ns, 0.5), quartiles: [quantile(ns, 0.25), quantile(ns, 0.75)] };
        (way.name().to_owned(), time)
    };
    let first = &model.entries[0];
    Candidate {
        name: model.name.clone(),
        kind: model.kind.to_owned(),
        net: Case::new(first.material.clone()).size(),
        file: model.file.display().to_string(),
        sha256: model.sha256.clone(),
        command: first.origin.command.clone(),
        materials: model.entries.len(),
        own_bytes: model.bytes.0,
        shared_bytes: model.bytes.1,
        fit_seconds: model.fit_seconds,
        times: Way::ALL.into_iter().zip(times).map(time).collect(),
    }
}
