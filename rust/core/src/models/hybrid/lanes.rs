//! Hybrids side by side: one material in all lanes, or another in each.
//!
//! Hybrids of one network differ in what comes before it, the inputs and the first bias with the latent code folded
//! in, and in what is made of its outputs.

use super::{Form, Hybrid, MAX_INPUTS};
use crate::kernels::mixed::MixedKernel;
use crate::kernels::network::{Bias, Network, Rows};
use crate::microfacet::Terms;
use crate::models::edit::{Edit, KNOTS, Room, Turn};
use crate::simd::{LANES, Lanes, Real, Spread, Vector};

/// What a material does not share with others of its network, but for the first bias: numbers for all lanes, or
/// for each. `M` is a truth value in every lane.
pub(super) struct Own<S, M> {
    /// Of p₀, beside which the network was fitted.
    terms: Terms<S>,
    bound: S,
    /// `None` where no lane's material is an edit.
    edit: Option<OwnEdit<S, M>>,
}

/// What an edit adds to it.
struct OwnEdit<S, M> {
    /// The lanes whose material is one; `None` for every lane.
    lanes: Option<M>,
    terms: Terms<S>,
    room: Room<S>,
    turn: Option<OwnTurn<S, M>>,
}

/// What an edit adds that asks the network about another pair.
struct OwnTurn<S, M> {
    /// The lanes where it does; `None` for every lane.
    lanes: Option<M>,
    turn: Turn<S>,
}

impl<M> Own<f32, M> {
    /// A material in all lanes.
    #[inline(always)]
    pub(super) fn of(material: &Hybrid) -> Self {
        let edit = match &material.edit {
            Some(edit) => Some(OwnEdit {
                lanes: None,
                terms: edit.terms,
                room: edit.room,
                turn: match edit.turn {
                    Some(turn) => Some(OwnTurn { lanes: None, turn }),
                    None => None,
                },
            }),
            None => None,
        };
        Own { terms: material.terms, bound: material.bound, edit }
    }
}

/// The numbers of [`Own`] in a row, but for those of an edit.
const OWN_COUNT: usize = Terms::COUNT + 1;

/// The numbers of [`OwnEdit`] in a row: those of the edit, whether it is one, and whether it turns.
const EDIT_COUNT: usize = Terms::COUNT + KNOTS + Turn::COUNT + 2;

/// A row of them, padded for [`Vector::transpose`].
const EDIT_ROW: usize = EDIT_COUNT.next_multiple_of(4);

#[inline(always)]
fn own_row(material: &Hybrid) -> [f32; OWN_COUNT] {
    let mut row = [material.bound; OWN_COUNT];
    row[..Terms::COUNT].copy_from_slice(&material.terms.to_row());
    row
}

#[inline(always)]
fn edit_row(edit: &Edit) -> [f32; EDIT_ROW] {
    let growth = edit.turn.map_or([0.0; Turn::COUNT], |turn| turn.growth);
    let flags = [1.0, if edit.turn.is_some() { 1.0 } else { 0.0 }];
    let mut row = [0.0; EDIT_ROW];
    let mut rest = &mut row[..];
    for numbers in [&edit.terms.to_row()[..], &edit.room.shares, &growth, &flags] {
        let (part, after) = rest.split_at_mut(numbers.len());
        part.copy_from_slice(numbers);
        rest = after;
    }
    row
}

impl<F: Real> OwnEdit<F, F::Mask> {
    #[inline(always)]
    fn from_row(row: &[F; EDIT_ROW]) -> Self {
        const WHOLE: &str = "a row has the numbers of its parts";
        let (terms, rest) = row.split_first_chunk().expect(WHOLE);
        let (shares, rest) = rest.split_first_chunk().expect(WHOLE);
        let (growth, rest) = rest.split_first_chunk().expect(WHOLE);
        let zero = row[0].splat(0.0);
        OwnEdit {
            lanes: Some(zero.lt(rest[0])),
            terms: Terms::from_row(*terms),
            room: Room { shares: *shares },
            turn: Some(OwnTurn { lanes: Some(zero.lt(rest[1])), turn: Turn { growth: *growth } }),
        }
    }
}

impl MixedKernel for Hybrid {
    #[inline(always)]
    fn eval_mixed<I: Lanes<L>, const L: usize>(
        isa: I,
        materials: &[&Self; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut rows = [[0.0; OWN_COUNT]; L];
        let mut has_edits = false;
        for lane in 0..L {
            rows[lane] = own_row(materials[lane]);
            has_edits |= materials[lane].edit.is_some();
        }
        let [terms @ .., bound] = Vector::transpose(isa, &rows);
        let mut own = Own { terms: Terms::from_row(terms), bound, edit: None };
        if has_edits {
            let mut rows = [[0.0; EDIT_ROW]; L];
            for lane in 0..L {
                if let Some(edit) = &materials[lane].edit {
                    rows[lane] = edit_row(edit);
                }
            }
            own.edit = Some(OwnEdit::from_row(&Vector::transpose(isa, &rows)));
        }
        let first = materials[0];
        let mut first_bias = Rows::default();
        for part in 0..first.first_bias.len() {
            let mut rows = [[0.0; LANES]; L];
            for lane in 0..L {
                rows[lane] = materials[lane].first_bias[part];
            }
            for row in Vector::transpose(isa, &rows) {
                first_bias.push(isa, [row.lanes()]);
            }
        }
        evaluate(isa, first.form, &first.network, &first_bias[..], &own, light, view)
    }
}

/// `a` in the lanes that there are, which are all for `None`, and `b` in the others.
#[inline(always)]
fn in_lanes<F: Real>(lanes: Option<F::Mask>, a: F, b: F) -> F {
    match lanes {
        Some(mask) => Real::select(mask, a, b),
        None => a,
    }
}

/// f of pairs above the horizon side by side.
#[inline(always)]
pub(super) fn evaluate<I: Lanes<L>, S: Spread<Vector<I, L>>, const L: usize>(
    isa: I,
    form: Form,
    network: &Network,
    first_bias: impl Bias<L>,
    own: &Own<S, I::Mask>,
    light: [Vector<I, L>; 3],
    view: [Vector<I, L>; 3],
) -> [Vector<I, L>; 3] {
    let (mut asked_light, mut asked_view) = (light, view);
    if let Some(OwnEdit { turn: Some(OwnTurn { lanes, turn }), .. }) = &own.edit {
        let [turned_light, turned_view] = turn.apply(light, view);
        for c in 0..3 {
            asked_light[c] = in_lanes(*lanes, turned_light[c], light[c]);
            asked_view[c] = in_lanes(*lanes, turned_view[c], view[c]);
        }
    }
    let mut x = [[0.0; L]; MAX_INPUTS];
    let analytic = form.inputs_and_analytic(&own.terms, asked_light, asked_view, &mut x);
    let mut y = Rows::default();
    network.forward_tile(isa, first_bias, &x, &mut y);
    // A composition of three outputs has no b.
    let second = y.len() - 3;
    let bound = own.bound.spread(analytic[0]);
    let mut f = analytic;
    for c in 0..3 {
        let [a, b] = [Vector::load(isa, &y[c]), Vector::load(isa, &y[c + second])];
        f[c] = form.composition.compose(a, b, analytic[c], bound);
    }
    if let Some(edit) = &own.edit {
        let (edited, room) = (edit.terms.eval(light, view), edit.room.share(light, view));
        for c in 0..3 {
            let [a, b] = [Vector::load(isa, &y[c]), Vector::load(isa, &y[c + second])];
            let whole = form.composition.compose_edited(a, b, analytic[c], edited[c], room, bound);
            f[c] = in_lanes(edit.lanes, whole, f[c]);
        }
    }
    f
}
