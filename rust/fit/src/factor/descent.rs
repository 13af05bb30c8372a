//! The descents of one colour channel: alternating weighted least squares (the paper, §4.2 and 4.3).

use glimt_core::models::factor::smith;
use glimt_core::models::factor::{AZIMUTH_BINS, DIFF_BINS, HALF_BINS, MASKING_KNOTS};

use super::anderson::Anderson;
use super::masking::{Folded, Masking, smooth};
use super::naive::{Azimuth, Whole};
use super::product::{FixedSums, Floor, State, Sums};

/// How a descent ended.
#[derive(Clone, Debug)]
pub struct Descent<Third> {
    /// ρ_d, ρ_s, D and F.
    pub state: State,
    /// G or H.
    pub third: Third,
    /// The objective after every accepted step, which never rises.
    pub trace: Vec<f64>,
    /// Steps that needed golden-section search.
    pub golden_sections: usize,
}

impl<Third> Descent<Third> {
    /// The objective at the end (eq. 7).
    #[must_use]
    pub fn objective(&self) -> f64 {
        *self.trace.last().expect("a descent starts with its objective")
    }
}

/// When a descent ends.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// A step that lowers the objective by less than this fraction is the last.
    pub tolerance: f64,
    /// Most steps of the third factor.
    pub steps: usize,
}

/// Most steps of D, F, ρ_d and ρ_s between two of the third factor, and the fraction of the objective by
/// which the last of them falls.
const RELAX_STEPS: usize = 100;
const RELAX_TOLERANCE: f64 = 1e-7;

/// A third factor as a descent sees it.
struct Problem<'a, Third> {
    sum: &'a dyn Fn(&Third, &mut Sums),
    fixed: &'a FixedSums,
    floor: Floor,
}

impl<Third> Problem<'_, Third> {
    /// The objective with the best D, F, ρ_d and ρ_s that a few steps find; `state` becomes these.
    fn relax(&self, third: &Third, state: &mut State, sums: &mut Sums) -> f64 {
        (self.sum)(third, sums);
        state.relax(sums, self.fixed, self.floor, RELAX_TOLERANCE, RELAX_STEPS)
    }
}

/// Fits all factors with a G of its own, from `masking` and `state` on.
#[must_use]
pub fn independent_g(
    folded: &Folded,
    state: State,
    masking: Masking,
    patience: Patience,
) -> Descent<Masking> {
    let floor = Floor::DYNAMIC_RANGE;
    let sum = |masking: &Masking, sums: &mut Sums| folded.sum(masking, sums);
    let problem = Problem { sum: &sum, fixed: &folded.fixed, floor };
    // Newton's step of the square root: half way to the G that fits while that of the other direction stays.
    // The step is smoothed instead of G itself, so that a smooth G stays so and the descent has an end.
    let solve = |state: &State, masking: &Masking| {
        let solved = folded.solve(state, masking);
        let step = smooth(&std::array::from_fn(|i| 0.5 * (solved[i] - masking[i])));
        let mut next = std::array::from_fn(|i| (masking[i] + step[i]).max(0.0));
        // ρ_s follows from the next step of the scales.
        floor.normalize(&mut next);
        next
    };
    descend(&problem, state, smooth(&masking), &solve, patience)
}

/// Fits all factors of the naive model.
#[must_use]
pub fn naive(whole: &Whole, state: State, azimuth: Azimuth, patience: Patience) -> Descent<Azimuth> {
    let floor = Floor::ZERO;
    let sum = |azimuth: &Azimuth, sums: &mut Sums| whole.sum(azimuth, sums);
    let problem = Problem { sum: &sum, fixed: &whole.fixed, floor };
    let solve = |state: &State, azimuth: &Azimuth| {
        let mut next = whole.solve(state, azimuth);
        floor.normalize(&mut next);
        next
    };
    descend(&problem, state, azimuth, &solve, patience)
}

/// Steps of the third factor, each followed by those of the others. A step that does not lower the objective
/// is shortened by golden-section search.
fn descend<const N: usize>(
    problem: &Problem<[f64; N]>,
    mut state: State,
    mut third: [f64; N],
    solve: &dyn Fn(&State, &[f64; N]) -> [f64; N],
    patience: Patience,
) -> Descent<[f64; N]> {
    let mut sums = Sums::new();
    let mut trace = vec![problem.relax(&third, &mut state, &mut sums)];
    let mut golden_sections = 0;
    let mut anderson = Anderson::default();
    for _ in 0..patience.steps {
        let before = trace[trace.len() - 1];
        let target = solve(&state, &third);
        let (mut next, mut next_state) = (target, state.clone());
        let mut objective = problem.relax(&next, &mut next_state, &mut sums);
        if objective >= before {
            golden_sections += 1;
            let t = golden_section(|t| {
                (problem.sum)(&between(&third, &target, t), &mut sums);
                state.clone().step_scales(&sums, problem.fixed)
            });
            next = between(&third, &target, t);
            problem.floor.normalize(&mut next);
            next_state = state.clone();
            objective = problem.relax(&next, &mut next_state, &mut sums);
        }
        if objective >= before {
            break;
        }
        if let Some(guess) = anderson.extrapolate(pack(&state, &third), pack(&next_state, &next)) {
            let (mut guess_state, guess) = unpack(&guess, &next_state, problem.floor);
            let guessed = problem.relax(&guess, &mut guess_state, &mut sums);
            if guessed < objective {
                (next, next_state, objective) = (guess, guess_state, guessed);
            }
        }
        (third, state) = (next, next_state);
        trace.push(objective);
        if before - objective < patience.tolerance * objective {
            break;
        }
    }
    Descent { state, third, trace, golden_sections }
}

/// All factors as one vector of logarithms, in which an extrapolation stays positive.
fn pack(state: &State, third: &[f64]) -> Vec<f64> {
    let factors = third.iter().chain(&state.ndf).chain(&state.fresnel[..DIFF_BINS]);
    factors.map(|x| x.max(Floor::DYNAMIC_RANGE.0).ln()).collect()
}

fn unpack<const N: usize>(packed: &[f64], scales: &State, floor: Floor) -> (State, [f64; N]) {
    let mut state = scales.clone();
    let (third, rest) = packed.split_at(N);
    let (ndf, fresnel) = rest.split_at(HALF_BINS);
    let mut third = std::array::from_fn(|i| third[i].exp());
    state.ndf = std::array::from_fn(|i| ndf[i].exp());
    for (to, from) in state.fresnel.iter_mut().zip(fresnel) {
        *to = from.exp();
    }
    floor.normalize(&mut third);
    floor.normalize(&mut state.ndf);
    floor.normalize(&mut state.fresnel[..DIFF_BINS]);
    (state, third)
}

/// Fits D and F under the G that follows from D. D is solved for under the G of the last step; where that
/// does not lower the objective once G follows, the step along D is shortened.
#[must_use]
pub fn g_from_d(folded: &Folded, mut state: State, patience: Patience) -> Descent<Masking> {
    let sum = |masking: &Masking, sums: &mut Sums| folded.sum(masking, sums);
    let problem = Problem { sum: &sum, fixed: &folded.fixed, floor: Floor::ZERO };
    let mut sums = Sums::new();
    let mut masking = smith::masking_of(&state.ndf);
    (problem.sum)(&masking, &mut sums);
    let mut trace = vec![state.step_scales(&sums, problem.fixed)];
    let mut golden_sections = 0;
    // F and the scales that fit to a D, and the objective.
    let follow = |state: &mut State, masking: &Masking, sums: &mut Sums| {
        (problem.sum)(masking, sums);
        state.step_scales(sums, problem.fixed);
        state.step_fresnel(sums, problem.floor);
        state.step_scales(sums, problem.fixed)
    };
    for _ in 0..patience.steps {
        let before = trace[trace.len() - 1];
        let mut target = state.clone();
        problem.relax(&masking, &mut target, &mut sums);
        let mut next = target.clone();
        let mut next_masking = smith::masking_of(&next.ndf);
        let mut objective = follow(&mut next, &next_masking, &mut sums);
        if objective >= before {
            golden_sections += 1;
            let along = |t: f64| {
                let mut state = State { ndf: between(&state.ndf, &target.ndf, t), ..state.clone() };
                state.fresnel = between(&state.fresnel, &target.fresnel, t);
                problem.floor.normalize(&mut state.ndf);
                let masking = smith::masking_of(&state.ndf);
                (state, masking)
            };
            let t = golden_section(|t| {
                let (mut state, masking) = along(t);
                follow(&mut state, &masking, &mut sums)
            });
            (next, next_masking) = along(t);
            objective = follow(&mut next, &next_masking, &mut sums);
        }
        if objective >= before {
            break;
        }
        (state, masking) = (next, next_masking);
        trace.push(objective);
        if before - objective < patience.tolerance * objective {
            break;
        }
    }
    Descent { state, third: masking, trace, golden_sections }
}

fn between<const N: usize>(from: &[f64; N], to: &[f64; N], t: f64) -> [f64; N] {
    std::array::from_fn(|i| from[i] + (to[i] - from[i]) * t)
}

/// Where in [0, 1] the least value of `f` was found (Press et al. 2007, §10.2).
fn golden_section(mut f: impl FnMut(f64) -> f64) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_895;
    // The interval ends 1/300 long.
    const SHRINKS: usize = 12;
    let (mut low, mut high) = (0.0, 1.0);
    let (mut a, mut b) = (1.0 - RATIO, RATIO);
    let (mut f_a, mut f_b) = (f(a), f(b));
    for _ in 0..SHRINKS {
        if f_a < f_b {
            (high, b, f_b) = (b, a, f_a);
            a = high - RATIO * (high - low);
            f_a = f(a);
        } else {
            (low, a, f_a) = (a, b, f_b);
            b = low + RATIO * (high - low);
            f_b = f(b);
        }
    }
    if f_a < f_b { a } else { b }
}

/// H of nothing known.
pub const CONSTANT_AZIMUTH: Azimuth = [1.0; AZIMUTH_BINS];
/// G of nothing known.
pub const CONSTANT_MASKING: Masking = [1.0; MASKING_KNOTS];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_section_finds_the_least_value() {
        assert!((golden_section(|t| (t - 0.3).powi(2)) - 0.3).abs() < 5e-3);
        assert!(golden_section(|t| t) < 5e-3);
    }
}
