//! Fitting glimt's models to measured or simulated reflectance.
//!
//! [`fit()`] makes a library of materials, [`add()`] adds some to one. Below them, in reading order: [`fittable`] (what
//! a model says of its fit, and the fit of any that does), [`train`] (the loop), [`objective`] and [`gradient`] (a
//! model as a function of numbers, and its derivatives, written by hand), [`adamw`], [`judge`], [`checkpoint`].
//!
//! Each model is a file: [`ggx`], [`hybrid`], [`neural`], [`spherical`]; [`options`] lists them. They are made of
//! [`net`] and [`backprop`], [`analytic`] and [`loss`]. [`factor`] needs no gradients. [`input`], [`truth`] and
//! [`pairs`] are what is fitted to. [`doubts`] says what a fit goes on with, but what is hardly meant.

pub mod adamw;
pub mod add;
pub mod analytic;
pub mod backprop;
pub mod checkpoint;
pub mod doubts;
pub mod error;
pub mod factor;
pub mod fit;
pub mod fittable;
pub mod ggx;
pub mod gradient;
pub mod hybrid;
pub mod input;
pub mod judge;
pub mod loss;
pub mod net;
pub mod neural;
pub mod objective;
pub mod options;
pub mod pairs;
pub mod spherical;
pub mod surfaces;
pub mod train;
pub mod truth;

pub use add::add;
pub use doubts::{Doubt, doubts, doubts_of, doubts_of_tables};
pub use error::Error;
pub use factor::{FactorFit, FactorOptions, fit_factor};
pub use fit::{Outcome, fit};
pub use ggx::GgxOptions;
pub use hybrid::{HybridOptions, InputChoice, Recipe};
pub use input::Input;
pub use net::Net;
pub use neural::NeuralOptions;
pub use options::{Model, Options};
pub use spherical::SphericalOptions;
pub use train::Watch;
pub use truth::{Truth, held_out};
