//! What is odd about a file that is read all the same.
//!
//! Files of measurements hold the traces of how they were made: noise below 0, bins that no camera saw, bytes
//! after the end. What the formats' own readers accept is read here too, and what was made of it is kept for
//! whoever wants to know.

use std::fmt;

use serde::Serialize;

/// Something odd in a file, and how often.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Oddity {
    /// Numbers below 0 in a quantity that has none; they are taken as 0.
    Negative {
        /// The quantity, as the format calls it.
        what: &'static str,
        /// How many numbers.
        count: usize,
    },
    /// Projected areas of 0 or less, by which f would be divided; they are filled from their neighbours.
    NoArea {
        /// How many areas.
        count: usize,
    },
    /// Bins that hold the mark of no data; they are filled from their neighbours.
    NoData {
        /// How many of them are above the horizon: the holes of the measurement.
        holes: usize,
        /// How many are below the horizon, where there is nothing to measure.
        below_horizon: usize,
    },
    /// Samples with a direction at the horizon, which carry no light; they are left out.
    Grazing {
        /// How many samples.
        count: usize,
    },
    /// Bytes after the end of what the format describes; they are ignored.
    Trailing {
        /// How many bytes.
        bytes: usize,
    },
}

impl Oddity {
    /// Whether it was found at all: a count of nothing is not worth a word.
    #[must_use]
    pub fn is_there(&self) -> bool {
        match *self {
            Oddity::Negative { count, .. } | Oddity::NoArea { count } | Oddity::Grazing { count } => {
                count > 0
            }
            Oddity::NoData { holes, below_horizon } => holes + below_horizon > 0,
            Oddity::Trailing { bytes } => bytes > 0,
        }
    }
}

/// One line in words.
impl fmt::Display for Oddity {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match *self {
            Oddity::Negative { what, count } => write!(f, "{} of {what}, taken as 0", negatives(count)),
            Oddity::NoArea { count: 1 } => {
                write!(f, "1 area that is not above 0, filled from its neighbours")
            }
            Oddity::NoArea { count } => {
                write!(f, "{count} areas that are not above 0, filled from their neighbours")
            }
            Oddity::NoData { holes, below_horizon } => write!(
                f,
                "{holes} bins without data above the horizon, filled from their neighbours, and {below_horizon} below"
            ),
            Oddity::Grazing { count } => write!(f, "{count} samples at the horizon, left out"),
            Oddity::Trailing { bytes } => write!(f, "{bytes} bytes after the end, ignored"),
        }
    }
}

fn negatives(count: usize) -> String {
    format!("{count} negative number{}", if count == 1 { "" } else { "s" })
}
