//! Fitting glimt's models to measured or simulated reflectance.
//!
//! [`fit()`] makes a library of materials, [`add()`] adds some to one. Below them, in reading order:
//! [`options`], [`train`] (the loop), [`objective`] with [`ggx`], [`hybrid`], [`neural`] and [`spherical`] (the models
//! as functions of numbers, with hand-written gradients), [`backprop`], [`analytic`], [`truth`],
//! [`pairs`], [`loss`], [`adamw`]. [`doubts`] says what a fit goes on with, but what is hardly meant.

pub mod adamw;
pub mod add;
pub mod analytic;
pub mod backprop;
pub mod checkpoint;
pub mod doubts;
pub mod error;
pub mod factor;
pub mod fit;
pub mod ggx;
pub mod hybrid;
pub mod loss;
pub mod neural;
pub mod objective;
pub mod options;
pub mod pairs;
pub mod spherical;
pub mod train;
pub mod truth;

pub use add::add;
pub use doubts::{Doubt, doubts, doubts_of, doubts_of_tables};
pub use error::Error;
pub use factor::{FactorFit, FactorOptions, fit_factor};
pub use fit::{Input, Outcome, Watch, fit};
pub use options::{HybridOptions, InputChoice, Model, Net, NeuralOptions, Options, Recipe, SphericalOptions};
pub use truth::{Truth, held_out};
