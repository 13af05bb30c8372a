//! Other sizes of a texture: an exact box filter down, bilinear up, each along its own axis.

/// The texels of an axis that make one of another, from `first` on and around the end; weights add up to 1.
struct Taps {
    first: usize,
    weights: Vec<f64>,
}

/// `to` texels over the same length as `from`.
fn axis(from: usize, to: usize) -> Vec<Taps> {
    (0..to).map(|i| if to > from { between(from, to, i) } else { covered(from, to, i) }).collect()
}

/// The two texels beside the centre of texel `i`. Textures of surfaces repeat, so that the last is beside the first.
fn between(from: usize, to: usize, i: usize) -> Taps {
    let centre = (i as f64 + 0.5) * from as f64 / to as f64 - 0.5;
    let t = centre - centre.floor();
    Taps { first: (centre.floor() as isize).rem_euclid(from as isize) as usize, weights: vec![1.0 - t, t] }
}

/// The texels that texel `i` covers, by the shares of it that they have. In units of 1/`to` of an old texel and as
/// integers, so that whole factors have equal weights.
fn covered(from: usize, to: usize, i: usize) -> Taps {
    let (start, end) = (i * from, (i + 1) * from);
    let first = start / to;
    let share = |j: usize| ((j + 1) * to).min(end) - (j * to).max(start);
    let weights = (first..end.div_ceil(to)).map(|j| share(j) as f64 / from as f64).collect();
    Taps { first, weights }
}

/// An image of another size. `texel` gives the values of one by its number, row by row.
pub(crate) fn resample<const N: usize>(
    from: [usize; 2],
    to: [usize; 2],
    texel: impl Fn(usize) -> [f32; N],
) -> Vec<[f32; N]> {
    if from == to {
        return (0..to[0] * to[1]).map(texel).collect();
    }
    let (columns, rows) = (axis(from[0], to[0]), axis(from[1], to[1]));
    let mut texels = Vec::with_capacity(to[0] * to[1]);
    for row in &rows {
        for column in &columns {
            let mut sum = [0.0_f64; N];
            for (j, &down) in row.weights.iter().enumerate() {
                let start = (row.first + j) % from[1] * from[0];
                for (i, &across) in column.weights.iter().enumerate() {
                    let value = texel(start + (column.first + i) % from[0]);
                    for (sum, value) in sum.iter_mut().zip(value) {
                        *sum += down * across * f64::from(value);
                    }
                }
            }
            texels.push(sum.map(|sum| sum as f32));
        }
    }
    texels
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn numbers(size: [usize; 2]) -> Vec<f32> {
        (0..size[0] * size[1]).map(|i| (i * i % 17) as f32 / 16.0).collect()
    }

    fn mean(values: &[[f32; 1]]) -> f64 {
        values.iter().map(|[value]| f64::from(*value)).sum::<f64>() / values.len() as f64
    }

    #[test]
    fn whole_factors_are_means_of_blocks() {
        let old = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        assert_eq!(resample([4, 2], [2, 1], |i| [old[i]]), [[2.5], [4.5]]);
        assert_eq!(resample([4, 2], [4, 1], |i| [old[i]]), [[2.0], [3.0], [4.0], [5.0]]);
        // 3 to 2: the middle texel goes half to each.
        assert_eq!(resample([3, 1], [2, 1], |i| [old[i]]), [[1.0 / 3.0], [5.0 / 3.0]]);
    }

    #[test]
    fn enlarging_is_linear_between_centres_and_around_the_edge() {
        let values = resample([2, 1], [4, 1], |i| [i as f32]);
        assert_eq!(values, [[0.25], [0.25], [0.75], [0.75]]);
        assert_eq!(resample([1, 1], [3, 2], |_| [0.3]), [[0.3]; 6]);
    }

    proptest! {
        #[test]
        fn the_mean_of_a_smaller_image_is_that_of_the_larger(
            (from, to) in (1_usize..24, 1_usize..24).prop_flat_map(|(w, h)| {
                ([Just(w), Just(h)], [1..=w, 1..=h])
            })
        ) {
            let old = numbers(from);
            let new = resample(from, to, |i| [old[i]]);
            let old: Vec<[f32; 1]> = old.into_iter().map(|value| [value]).collect();
            prop_assert!((mean(&new) - mean(&old)).abs() < 1e-6);
        }

        #[test]
        fn weights_add_up_to_one_and_name_texels(from in 1_usize..40, to in 1_usize..40) {
            for taps in axis(from, to) {
                prop_assert!(taps.first < from);
                prop_assert!((taps.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                prop_assert!(taps.weights.iter().all(|w| (0.0..=1.0 + 1e-12).contains(w)));
            }
        }

        #[test]
        fn two_steps_down_are_one(w in 1_usize..6, h in 1_usize..6, a in 1_usize..4, b in 1_usize..4) {
            let (large, middle, small) = ([w * a * b, h * a * b], [w * a, h * a], [w, h]);
            let old = numbers(large);
            let once = resample(large, small, |i| [old[i]]);
            let halfway = resample(large, middle, |i| [old[i]]);
            let twice = resample(middle, small, |i| halfway[i]);
            for (a, b) in once.iter().zip(&twice) {
                prop_assert!((a[0] - b[0]).abs() < 1e-6);
            }
        }
    }
}
