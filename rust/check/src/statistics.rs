//! p-values, and what to make of many.

use statrs::distribution::{ChiSquared, ContinuousCDF};
use statrs::function::erf::erfc;

/// Probability that a standard normal number is at least as far from 0 as `z`.
#[must_use]
pub fn two_sided(z: f64) -> f64 {
    erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Probability that a standard normal number is at least `z`.
#[must_use]
pub fn one_sided(z: f64) -> f64 {
    0.5 * erfc(z / std::f64::consts::SQRT_2)
}

/// Probability of the least of `count` independent p-values being `least` or less (Šidák 1967).
#[must_use]
pub fn least_of(least: f64, count: usize) -> f64 {
    -(count as f64 * (-least).ln_1p()).exp_m1()
}

/// The threshold for each of `count` tests at which a run of correct subjects fails with probability
/// `significance`: Šidák's correction.
#[must_use]
pub fn threshold(significance: f64, count: usize) -> f64 {
    -((-significance).ln_1p() / count.max(1) as f64).exp_m1()
}

/// A bin: how many were expected, and how many came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// Expected number.
    pub expected: f64,
    /// Observed number.
    pub observed: f64,
}

/// Least expected number of a bin for which χ² of counts is near its limit (Cochran 1954).
pub const MIN_EXPECTED: f64 = 5.0;

/// χ² over `bins` and its p-value, with bins that expect too little pooled; `None` if fewer than two remain.
///
/// The numbers of all bins together are those of all draws, so one degree of freedom is lost.
#[must_use]
pub fn chi_squared(mut bins: Vec<Bin>) -> Option<ChiSquare> {
    bins.sort_by(|a, b| a.expected.total_cmp(&b.expected));
    let mut pooled: Vec<Bin> = Vec::with_capacity(bins.len());
    let mut pool = Bin { expected: 0.0, observed: 0.0 };
    for bin in bins {
        pool.expected += bin.expected;
        pool.observed += bin.observed;
        if pool.expected >= MIN_EXPECTED {
            pooled.push(std::mem::replace(&mut pool, Bin { expected: 0.0, observed: 0.0 }));
        }
    }
    if let Some(last) = pooled.last_mut() {
        last.expected += pool.expected;
        last.observed += pool.observed;
    }
    if pooled.len() < 2 {
        return None;
    }
    let statistic = pooled.iter().map(|bin| (bin.observed - bin.expected).powi(2) / bin.expected).sum();
    let freedom = pooled.len() - 1;
    let distribution = ChiSquared::new(freedom as f64).expect("a positive number of degrees of freedom");
    Some(ChiSquare { statistic, freedom, p: distribution.sf(statistic) })
}

/// The result of [`chi_squared`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChiSquare {
    /// Σ (observed − expected)² / expected.
    pub statistic: f64,
    /// Degrees of freedom.
    pub freedom: usize,
    /// Probability of a statistic at least as large.
    pub p: f64,
}

/// Mean and variance of numbers that are added one by one (Welford 1962).
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    /// Takes one more number.
    pub fn add(&mut self, x: f64) {
        self.count += 1.0;
        let difference = x - self.mean;
        self.mean += difference / self.count;
        self.squares += difference * (x - self.mean);
    }

    /// The mean.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// The variance of one number.
    #[must_use]
    pub fn variance(&self) -> f64 {
        if self.count > 1.0 { self.squares / (self.count - 1.0) } else { 0.0 }
    }

    /// The standard error of the mean.
    #[must_use]
    pub fn standard_error(&self) -> f64 {
        (self.variance() / self.count.max(1.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_values_are_those_of_the_tables() {
        assert!((two_sided(1.959_963_985) - 0.05).abs() < 1e-8);
        assert!((one_sided(1.644_853_627) - 0.05).abs() < 1e-8);
        // χ² of 11.0705 at 5 degrees of freedom: the 95 % quantile.
        let bins = (0..6).map(|i| {
            let surplus = if i % 2 == 0 { 1.0 } else { -1.0 } * (11.070_497_7 / 6.0 * 100.0_f64).sqrt();
            Bin { expected: 100.0, observed: 100.0 + surplus }
        });
        let result = chi_squared(bins.collect()).unwrap();
        assert_eq!(result.freedom, 5);
        assert!((result.p - 0.05).abs() < 1e-6, "{result:?}");
    }

    #[test]
    fn correction_keeps_the_significance_of_the_run() {
        for count in [1, 7, 1000] {
            let each = threshold(0.01, count);
            assert!((least_of(each, count) - 0.01).abs() < 1e-12);
        }
        assert_eq!(threshold(0.01, 1), 0.01);
    }

    #[test]
    fn bins_that_expect_little_are_pooled_and_nothing_is_lost() {
        let small = Bin { expected: 1.0, observed: 0.0 };
        let large = Bin { expected: 20.0, observed: 25.0 };
        let result = chi_squared(vec![small, small, small, small, small, small, small, large]).unwrap();
        // Five small ones make a bin; the two left over wait for the large one.
        assert_eq!(result.freedom, 1);
        let expected = 25.0 / 5.0 + (25.0_f64 - 22.0).powi(2) / 22.0;
        assert!((result.statistic - expected).abs() < 1e-12);
        assert_eq!(chi_squared(vec![small; 4]), None);
        let impossible = Bin { expected: 0.0, observed: 1000.0 };
        assert!(chi_squared(vec![impossible, large, large]).unwrap().p < 1e-300);
    }

    #[test]
    fn moments_are_those_of_the_numbers() {
        let mut moments = Moments::default();
        for x in [1.0, 2.0, 4.0, 9.0] {
            moments.add(x);
        }
        assert!((moments.mean() - 4.0).abs() < 1e-12);
        assert!((moments.variance() - 38.0 / 3.0).abs() < 1e-12);
        assert!((moments.standard_error() - (38.0 / 12.0_f64).sqrt()).abs() < 1e-12);
    }
}
