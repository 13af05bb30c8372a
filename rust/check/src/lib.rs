//! Does a BSDF do what it says? Conformance tests for any BSDF, a named catalogue of extreme inputs,
//! and the accuracy of every function of the core.
//!
//! Reading order: [`subject`] is what can be checked; [`run`] puts one through all tests; [`look`] is one view
//! of it, whose samples and [`cells`] several tests share. The tests are one file per family: [`horizon`],
//! [`consistency`], [`sampling`], [`energy`], [`edits`], [`components`], [`symmetry`]; [`audit`] sees every answer.
//! Answers are compared by [`difference`] and [`rounding`] at [`pairs`]. [`verdict`] says what findings mean,
//! [`report`] and [`page`] show them.
//!
//! Numerical stability: [`extremes`] is the catalogue, [`stability`] runs it, [`random_pairs`] goes beyond it,
//! [`functions`] measures the core's functions; all of them in the units of [`accuracy`].

pub mod accuracy;
pub mod audit;
pub mod cells;
pub mod components;
pub mod consistency;
pub mod difference;
pub mod edits;
pub mod energy;
pub mod extremes;
pub mod functions;
pub mod horizon;
pub mod look;
pub mod options;
pub mod page;
pub mod pairs;
pub mod picture;
pub mod random_pairs;
pub mod report;
pub mod rounding;
pub mod run;
pub mod sampling;
pub mod stability;
pub mod statistics;
pub mod subject;
pub mod svg;
pub mod symmetry;
pub mod verdict;
pub mod views;

pub use options::Options;
pub use report::Report;
pub use run::{Checked, check};
pub use subject::{Answer, BrdfSubject, Claims, Component, Draw, Part, Subject, Unanswered};
pub use verdict::{Test, Verdict};
