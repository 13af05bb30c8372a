//! Do samples fall where the density says? The χ² test of their histogram, and the integral of the density.

use crate::look::Look;
use crate::statistics::{Bin, chi_squared, two_sided};
use crate::verdict::{Finding, Measure, Test};

/// What quadrature may be off by: the integral of a density is known to this.
pub const QUADRATURE: f64 = 1e-3;

/// [`Test::ChiSquared`]: the counts of all cells, and of the samples that are in none, against the integral
/// of the density over each.
#[must_use]
pub fn histogram(look: &Look) -> Finding {
    let finding = |measure| Finding::new(Test::ChiSquared, measure).at(look.view);
    if look.samples.is_empty() {
        let why =
            if look.deltas.is_empty() { "no sample succeeds" } else { "all samples are of delta components" };
        return finding(Measure::LeftOut).note(why);
    }
    if !look.cells.settled {
        return Finding::unsettled(Test::ChiSquared, look.view);
    }
    let draws = look.count as f64;
    let mut bins: Vec<Bin> = look
        .cells
        .leaves()
        .map(|cell| Bin { expected: cell.integral.pdf * draws, observed: cell.observed as f64 })
        .collect();
    let elsewhere = draws * (1.0 - look.cells.total().pdf).max(0.0);
    bins.push(Bin { expected: elsewhere, observed: draws - look.samples.len() as f64 });
    bins.push(Bin { expected: 0.0, observed: look.cells.outside as f64 });
    let Some(result) = chi_squared(bins) else {
        return finding(Measure::LeftOut).note("too few samples succeed");
    };
    let delta = if look.deltas.is_empty() { "" } else { "; delta components left out" };
    finding(Measure::Statistic { statistic: result.statistic, p: result.p })
        .note(format!("χ² {:.0} at {} degrees of freedom{delta}", result.statistic, result.freedom))
}

/// [`Test::PdfIntegral`]: ∫ pdf against the share of samples that succeeded.
#[must_use]
pub fn integral(look: &Look) -> Finding {
    let finding = |measure| Finding::new(Test::PdfIntegral, measure).at(look.view);
    if !look.cells.settled {
        return Finding::unsettled(Test::PdfIntegral, look.view);
    }
    let (integral, share) = (look.cells.total().pdf, look.share());
    let draws = look.count as f64;
    let deviation = (share * (1.0 - share)).max(1.0 / draws) / draws;
    let z = ((integral - share).abs() - QUADRATURE).max(0.0) / deviation.sqrt();
    finding(Measure::Statistic { statistic: z, p: two_sided(z) })
        .note(format!("∫pdf {integral:.4}, {share:.4} of the samples succeed"))
}
