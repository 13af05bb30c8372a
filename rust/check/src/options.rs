//! How much work a check is.

use crate::cells::Resolution;

/// How much work a run is, and its random numbers.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Samples for each view.
    pub samples: usize,
    /// How finely the sphere is cut.
    pub resolution: Resolution,
    /// Pairs of directions at which answers are compared with each other.
    pub pairs: usize,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Options {
    /// For subjects that answer in batches. The subject is asked about a million times for each view.
    pub const FULL: Options = Options {
        samples: 200_000,
        resolution: Resolution { rows: 32, evaluations: 600_000 },
        pairs: 20_000,
        seed: 1,
    };

    /// For subjects whose answers take microseconds each, and for quick tests.
    pub const SMALL: Options = Options {
        samples: 10_000,
        resolution: Resolution { rows: 16, evaluations: 60_000 },
        pairs: 1_000,
        seed: 1,
    };
}
