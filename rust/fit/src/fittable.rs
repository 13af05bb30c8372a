//! What a model must say to be fitted, and the fit of any model that says it.

use std::ops::{ControlFlow, Range};

use glimt_core::Invalid;
use glimt_core::Material;
use glimt_core::library::{Entry, Origin};

use crate::adamw::Moments;
use crate::error::Error;
use crate::input::{self, Input, all_isotropic};
use crate::judge::{JUDGE_BLOCKS, Judge};
use crate::objective::Objective;
use crate::train::{End, Progress, Schedule, State, Watch, train};
use crate::truth::Truth;

/// Options of a model, from which it knows how its fit starts, what is trained, and what materials come of it.
pub trait Fittable {
    /// What is trained.
    type Objective: Objective + Clone;

    /// Whether the options make sense, and with these materials; if not, why.
    ///
    /// # Errors
    /// In words, what was found and what was expected.
    fn check(&self, inputs: &[Input]) -> Result<(), String>;

    /// What is trained, as it is when the fit starts.
    ///
    /// # Errors
    /// In words, options that [`Fittable::check`] refuses.
    fn objective(&self, isotropic: bool) -> Result<Self::Objective, String>;

    /// Which materials share numbers. Groups are fitted one after the other, as if each were alone.
    fn groups(&self, truths: &[Truth]) -> Vec<Vec<usize>> {
        vec![(0..truths.len()).collect()]
    }

    /// The first numbers of a group: the shared ones, then each material's own. `None` if `watch` stopped what comes
    /// before them.
    ///
    /// # Errors
    /// [`Error::Diverged`].
    fn start(
        &self,
        objective: &Self::Objective,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<f32>>, Error>;

    /// Steps of the training; 0 where a fit is over when it has started.
    fn steps(&self, schedule: &Schedule) -> u64 {
        schedule.steps
    }

    /// The steps, rising, after which the objective changes: multiples of [`REPORT_EVERY`](crate::train::REPORT_EVERY).
    fn turns(&self, _objective: &Self::Objective, _steps: u64) -> Vec<u64> {
        Vec::new()
    }

    /// Changes the objective to what it is after the turn at `step`, and `state` with it. There is no state where a
    /// fit is resumed beyond the turn, as it was changed then.
    fn turn(
        &self,
        _step: u64,
        _schedule: &Schedule,
        _objective: &mut Self::Objective,
        _state: Option<&mut State>,
    ) {
    }

    /// The materials of a group from its numbers.
    ///
    /// # Errors
    /// In words, numbers that make no material: they are not finite.
    fn finish(
        &self,
        objective: &Self::Objective,
        numbers: &[f32],
        truths: &[Truth],
        judge: &Judge,
    ) -> Result<Vec<Material>, Invalid>;

    /// What a library keeps of the options to go on from.
    fn recipe_json(&self) -> Option<serde_json::Value> {
        None
    }

    /// How many numbers each of so many materials has, its part of those that they share included; `None` for
    /// models that take as many as the samples allow.
    fn numbers_each(&self, materials: usize, isotropic: bool) -> Option<usize> {
        let objective = self.objective(isotropic).ok()?;
        Some(objective.own_len() + objective.shared_len() / materials.max(1))
    }
}

/// How the fit of a [`Fittable`] ended.
pub(crate) enum Fit {
    /// Every step is done.
    Done(Vec<Entry>),
    /// It was stopped; there is no state if it had not started.
    Stopped(Option<State>),
}

/// Fits `model` to `inputs`; goes on from `resumed` if it is given.
pub(crate) fn fit_model(
    model: &impl Fittable,
    inputs: &[Input],
    schedule: &Schedule,
    resumed: Option<State>,
    watch: &mut Watch,
) -> Result<Fit, Error> {
    model.check(inputs).map_err(Error::Options)?;
    input::check(inputs)?;
    let truths: Vec<Truth> = inputs.iter().map(|input| input.truth).collect();
    let objective = model.objective(all_isotropic(inputs)).map_err(Error::Options)?;
    let groups = model.groups(&truths);
    let truths: Vec<Vec<Truth>> =
        groups.iter().map(|group| group.iter().map(|&i| truths[i]).collect()).collect();
    let parts = parts(&objective, &groups);
    let mut state = match resumed {
        Some(state) => resume(state, &parts)?,
        None => match start(model, &objective, &truths, schedule, watch)? {
            Some(state) => state,
            None => return Ok(Fit::Stopped(None)),
        },
    };
    let steps = model.steps(schedule);
    let mut made: Vec<Option<Material>> = vec![None; inputs.len()];
    for (i, (group, truths)) in groups.iter().zip(&truths).enumerate() {
        let part = &parts[i];
        let before = i as u64 * steps;
        let mut of_group = part.take(&state, before, steps);
        let mut report = |progress: &Progress, of_group: &State| {
            part.put(of_group, before, &mut state);
            let steps = steps * groups.len() as u64;
            watch(&Progress { step: progress.step + before, steps, ..*progress }, Some(&state))
        };
        let schedule = Schedule { steps, ..*schedule };
        let end = fit_group(model, &objective, truths, &schedule, &mut of_group, &mut report);
        part.put(&of_group, before, &mut state);
        match end {
            GroupEnd::Done(materials) => {
                group.iter().zip(materials).for_each(|(&of, material)| made[of] = Some(material));
            }
            GroupEnd::Stopped => return Ok(Fit::Stopped(Some(state))),
            GroupEnd::Diverged => return Err(Error::Diverged { step: state.step }),
        }
    }
    Ok(Fit::Done(entries(inputs, made, schedule, model.recipe_json())))
}

/// The materials under their names, and what they come from.
fn entries(
    inputs: &[Input],
    made: Vec<Option<Material>>,
    schedule: &Schedule,
    recipe: Option<serde_json::Value>,
) -> Vec<Entry> {
    let entry = |(input, material): (&Input, Option<Material>)| Entry {
        name: input.name.clone(),
        material: material.expect("every material is in a group"),
        origin: Origin {
            seed: Some(schedule.seed),
            steps: Some(schedule.steps),
            recipe: recipe.clone(),
            ..input.origin.clone()
        },
    };
    inputs.iter().zip(made).map(entry).collect()
}

/// The first state of all groups; `None` if it was stopped.
fn start<F: Fittable>(
    model: &F,
    objective: &F::Objective,
    groups: &[Vec<Truth>],
    schedule: &Schedule,
    watch: &mut Watch,
) -> Result<Option<State>, Error> {
    let mut numbers = Vec::new();
    for truths in groups {
        let Some(first) = model.start(objective, truths, schedule, watch)? else { return Ok(None) };
        numbers.extend(first);
    }
    let materials = groups.iter().map(Vec::len).sum();
    Ok(Some(State::of(objective, materials, numbers)))
}

/// A group's part of the state of all.
struct Part {
    numbers: Range<usize>,
    rows: Range<usize>,
}

/// The part of each group.
fn parts(objective: &impl Objective, groups: &[Vec<usize>]) -> Vec<Part> {
    let (mut number, mut row) = (0, 0);
    let part = |group: &Vec<usize>| {
        let (numbers, rows) = (number, row);
        number += objective.shared_len() + group.len() * objective.own_len();
        row += group.len() * objective.table().rows;
        Part { numbers: numbers..number, rows: rows..row }
    };
    groups.iter().map(part).collect()
}

/// The state of a checkpoint, if it is of a fit of such parts.
fn resume(state: State, parts: &[Part]) -> Result<State, Error> {
    let (numbers, rows) = parts.last().map_or((0, 0), |part| (part.numbers.end, part.rows.end));
    let refused = |what: &str, found: usize, expected: usize| {
        Err(Error::Options(format!("the checkpoint holds {found} {what}, expected {expected}; fit anew")))
    };
    if state.numbers.len() != numbers || state.moments.first.len() != numbers {
        return refused("numbers", state.numbers.len(), numbers);
    }
    if state.moments.touched.len() != rows {
        return refused("rows of tables", state.moments.touched.len(), rows);
    }
    Ok(state)
}

impl Part {
    /// The state of the group, which comes after `before` steps of other groups and has `steps` of its own.
    fn take(&self, all: &State, before: u64, steps: u64) -> State {
        let Moments { first, second, touched } = &all.moments;
        State {
            numbers: all.numbers[self.numbers.clone()].to_vec(),
            moments: Moments {
                first: first[self.numbers.clone()].to_vec(),
                second: second[self.numbers.clone()].to_vec(),
                touched: touched[self.rows.clone()].to_vec(),
            },
            step: all.step.saturating_sub(before).min(steps),
        }
    }

    fn put(&self, part: &State, before: u64, all: &mut State) {
        all.numbers[self.numbers.clone()].copy_from_slice(&part.numbers);
        all.moments.first[self.numbers.clone()].copy_from_slice(&part.moments.first);
        all.moments.second[self.numbers.clone()].copy_from_slice(&part.moments.second);
        all.moments.touched[self.rows.clone()].copy_from_slice(&part.moments.touched);
        all.step = all.step.max(before + part.step);
    }
}

/// How the fit of a group ended.
enum GroupEnd {
    Done(Vec<Material>),
    Stopped,
    Diverged,
}

/// Trains a group and makes its materials.
fn fit_group<F: Fittable>(
    model: &F,
    objective: &F::Objective,
    truths: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    watch: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> GroupEnd {
    let mut objective = objective.clone();
    match train_group(model, &mut objective, truths, schedule, state, watch) {
        End::Finished => {}
        End::Stopped => return GroupEnd::Stopped,
        End::Diverged => return GroupEnd::Diverged,
    }
    let judge = Judge::new(schedule.drawing, schedule.seed, JUDGE_BLOCKS);
    let made = model.finish(&objective, &state.numbers, truths, &judge);
    made.map_or(GroupEnd::Diverged, GroupEnd::Done)
}

/// [`train`], from turn to turn.
fn train_group<F: Fittable>(
    model: &F,
    objective: &mut F::Objective,
    truths: &[Truth],
    schedule: &Schedule,
    state: &mut State,
    watch: &mut dyn FnMut(&Progress, &State) -> ControlFlow<()>,
) -> End {
    let turns = model.turns(objective, schedule.steps);
    let mut passed = 0;
    loop {
        // A state is kept before the turn of its step.
        let now = state.step;
        while passed < turns.len() && turns[passed] <= now {
            let step = turns[passed];
            model.turn(step, schedule, objective, (step == now).then_some(&mut *state));
            passed += 1;
        }
        let next = turns.get(passed).copied();
        let mut stopped = false;
        let end = train(objective, truths, schedule, state, &mut |progress, state| {
            stopped = watch(progress, state).is_break();
            let is_over = stopped || next == Some(progress.step);
            if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        if end != End::Stopped || stopped {
            return end;
        }
    }
}

/// A [`Fittable`] whose type does not matter.
pub(crate) trait AnyFittable {
    /// [`fit_model`].
    fn fit(
        &self,
        inputs: &[Input],
        schedule: &Schedule,
        resumed: Option<State>,
        watch: &mut Watch,
    ) -> Result<Fit, Error>;

    /// [`Fittable::numbers_each`].
    fn count_numbers(&self, materials: usize, isotropic: bool) -> Option<usize>;
}

impl<F: Fittable> AnyFittable for F {
    fn fit(
        &self,
        inputs: &[Input],
        schedule: &Schedule,
        resumed: Option<State>,
        watch: &mut Watch,
    ) -> Result<Fit, Error> {
        fit_model(self, inputs, schedule, resumed, watch)
    }

    fn count_numbers(&self, materials: usize, isotropic: bool) -> Option<usize> {
        self.numbers_each(materials, isotropic)
    }
}
