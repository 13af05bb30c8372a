//! Anderson's extrapolation of a sequence of factors.
//!
//! Alternating least squares creep where factors can trade against each other. What is left of the way is
//! guessed from the last few steps (Anderson 1965; Walker & Ni 2011, *Anderson Acceleration for Fixed-Point
//! Iterations*, §2). Whoever calls this compares objectives and takes the guess only where it is better.

/// Steps that are remembered.
const DEPTH: usize = 6;
/// Ridge of the small least squares, relative to their diagonal.
const RIDGE: f64 = 1e-9;

/// The last steps, each from a point to where one iteration brought it.
#[derive(Default)]
pub struct Anderson {
    steps: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Anderson {
    /// Remembers the step from `x` to `next`, and guesses where the sequence leads; `None` at first.
    pub fn extrapolate(&mut self, x: Vec<f64>, next: Vec<f64>) -> Option<Vec<f64>> {
        if self.steps.len() > DEPTH {
            self.steps.remove(0);
        }
        self.steps.push((x, next));
        let [before @ .., last] = &self.steps[..] else { return None };
        let residual = |step: &(Vec<f64>, Vec<f64>)| subtract(&step.1, &step.0);
        // Differences from the last step, in which the residual is to vanish.
        let last_residual = residual(last);
        let differences: Vec<Vec<f64>> =
            before.iter().map(|step| subtract(&last_residual, &residual(step))).collect();
        let n = differences.len();
        if n == 0 {
            return None;
        }
        let mut matrix = vec![vec![0.0; n + 1]; n];
        for i in 0..n {
            for j in 0..n {
                matrix[i][j] = dot(&differences[i], &differences[j]);
            }
            matrix[i][i] *= 1.0 + RIDGE;
            matrix[i][n] = dot(&differences[i], &last_residual);
        }
        let weights = solve(matrix)?;
        let mut guess = last.1.clone();
        for (step, weight) in before.iter().zip(weights) {
            for ((guess, last), next) in guess.iter_mut().zip(&last.1).zip(&step.1) {
                *guess -= weight * (last - next);
            }
        }
        guess.iter().all(|x| x.is_finite()).then_some(guess)
    }
}

fn subtract(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Gauss' elimination of a positive definite matrix with its right side as the last column.
fn solve(mut matrix: Vec<Vec<f64>>) -> Option<Vec<f64>> {
    let n = matrix.len();
    for i in 0..n {
        if matrix[i][i] <= 0.0 {
            return None;
        }
        let (above, below) = matrix.split_at_mut(i + 1);
        let pivot = &above[i];
        for row in below {
            let factor = row[i] / pivot[i];
            for (x, p) in row.iter_mut().zip(pivot).skip(i) {
                *x -= factor * p;
            }
        }
    }
    let mut solution = vec![0.0; n];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| matrix[i][j] * solution[j]).sum();
        solution[i] = (matrix[i][n] - known) / matrix[i][i];
    }
    Some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_sequence_is_led_to_its_end() {
        let step = |x: &[f64]| vec![0.9 * x[0] + 0.05 * x[1] + 1.0, 0.05 * x[0] + 0.8 * x[1] - 1.0];
        let (mut anderson, mut x) = (Anderson::default(), vec![0.0, 0.0]);
        for _ in 0..4 {
            let next = step(&x);
            x = anderson.extrapolate(x, next.clone()).unwrap_or(next);
        }
        // x = A x + b.
        let end = [8.571_428_571, -2.857_142_857];
        assert!((x[0] - end[0]).abs() < 1e-4 && (x[1] - end[1]).abs() < 1e-4, "{x:?}");
    }
}
