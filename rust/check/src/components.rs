//! Do components add up to the whole?

use glam::Vec3;

use crate::audit::pair;
use crate::difference::{FLOOR, ROUNDING, Worst, relative_rgb};
use crate::pairs::Pairs;
use crate::subject::{Answer, Part, Subject};
use crate::verdict::{Finding, Measure, Test};
use crate::views::View;

/// Relative error of the best mixture of components that still counts as one.
const MIXTURE: f64 = 1e-2;

/// [`Test::ComponentsEval`]: the sum of the components' responses against the whole.
///
/// # Errors
/// The subject's.
pub fn eval(subject: &dyn Subject, pairs: &Pairs) -> Answer<Finding> {
    let count = subject.components().len();
    let whole = subject.response(Part::Whole, &pairs.light, &pairs.view)?;
    let mut sum = vec![Vec3::ZERO; whole.len()];
    for component in 0..count {
        let part = subject.response(Part::Component(component), &pairs.light, &pairs.view)?;
        for (sum, part) in sum.iter_mut().zip(part) {
            *sum += part;
        }
    }
    let mut worst = Worst::none();
    for (i, (&sum, &whole)) in sum.iter().zip(&whole).enumerate() {
        worst.add(relative_rgb(sum, whole, FLOOR), || {
            format!("components {sum}, whole {whole} for {}", pair(pairs.light[i], pairs.view[i]))
        });
    }
    Ok(worst.finding(Test::ComponentsEval, ROUNDING))
}

/// [`Test::ComponentsPdf`]: whether there are shares for `view`, none negative and 1 together at most, with
/// which the densities of the components mix to that of the whole at all `lights`. A warning if not: a rough
/// dielectric chooses between its components at each microfacet, so that its shares depend on the light.
///
/// # Errors
/// The subject's.
pub fn pdf(subject: &dyn Subject, view: View, lights: &[Vec3]) -> Answer<Finding> {
    let views = vec![view.direction(); lights.len()];
    let whole = subject.pdf(Part::Whole, lights, &views)?;
    let mut parts = Vec::new();
    for (i, component) in subject.components().iter().enumerate() {
        if !component.delta {
            parts.push(subject.pdf(Part::Component(i), lights, &views)?);
        }
    }
    // Relative errors are to be small: every equation is divided by its right-hand side.
    let used: Vec<usize> = (0..lights.len()).filter(|&i| whole[i] > FLOOR).collect();
    if used.is_empty() || parts.is_empty() {
        return Ok(Finding::new(Test::ComponentsPdf, Measure::LeftOut).at(view).note("no density here"));
    }
    let rows: Vec<Vec<f64>> = used
        .iter()
        .map(|&i| parts.iter().map(|part| f64::from(part[i]) / f64::from(whole[i])).collect())
        .collect();
    let shares = shares(&rows);
    let mut worst = Worst::none();
    for (row, &i) in rows.iter().zip(&used) {
        let mixed: f64 = row.iter().zip(&shares).map(|(a, b)| a * b).sum();
        worst.add((mixed - 1.0).abs(), || {
            let mixed = mixed * f64::from(whole[i]);
            format!("best mixture {mixed}, whole {} for light {:?}, shares {shares:.3?}", whole[i], lights[i])
        });
    }
    let together: f64 = shares.iter().sum();
    worst.add(together - 1.0, || format!("shares {shares:.4?} exceed 1"));
    let mut finding = worst.finding(Test::ComponentsPdf, MIXTURE).warning().at(view);
    if finding.note.is_empty() {
        finding.note = format!("shares {shares:.3?}");
    }
    Ok(finding)
}

/// Rounds of [`shares`]; each goes once through the unknowns.
const ROUNDS: usize = 500;

/// x ≥ 0 that minimises Σ (row·x − 1)², by coordinate descent.
fn shares(rows: &[Vec<f64>]) -> Vec<f64> {
    let unknowns = rows[0].len();
    let product = |a: usize, b: usize| rows.iter().map(|row| row[a] * row[b]).sum::<f64>();
    let gram: Vec<Vec<f64>> = (0..unknowns).map(|a| (0..unknowns).map(|b| product(a, b)).collect()).collect();
    let right: Vec<f64> = (0..unknowns).map(|a| rows.iter().map(|row| row[a]).sum()).collect();
    let mut x = vec![0.0; unknowns];
    for _ in 0..ROUNDS {
        for a in 0..unknowns {
            if gram[a][a] > 0.0 {
                let others: f64 = (0..unknowns).filter(|&b| b != a).map(|b| gram[a][b] * x[b]).sum();
                x[a] = ((right[a] - others) / gram[a][a]).max(0.0);
            }
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_a_mixture_are_found() {
        let rows: Vec<Vec<f64>> = (0..50)
            .map(|i| {
                let (a, b) = (0.2 + f64::from(i), 3.0 / (1.0 + f64::from(i)));
                let whole = 0.3 * a + 0.7 * b;
                vec![a / whole, b / whole, 0.0]
            })
            .collect();
        let found = shares(&rows);
        for (found, expected) in found.iter().zip([0.3, 0.7, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{found} for {expected}");
        }
    }
}
