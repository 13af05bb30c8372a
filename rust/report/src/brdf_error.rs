//! Errors in BRDF space, over pairs of cosine-distributed directions.

use glam::Vec3;
use glimt_core::Brdf;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Angle to the normal beyond which a direction is grazing: a fifteenth of cosine-distributed directions.
pub const GRAZING_DEGREES: f32 = 75.0;

/// Pairs of directions to measure on, both cosine-distributed.
#[derive(Clone, Debug)]
pub struct Protocol {
    light: Vec<Vec3>,
    view: Vec<Vec3>,
}

impl Protocol {
    /// Pairs in the protocol of [`Protocol::reference`].
    pub const PAIRS: usize = 1_000_000;

    /// The pairs that published figures were measured on: NumPy's
    /// `default_rng(12345).random((10**6, 4))`, columns 0 and 1 for the view, 2 and 3 for the light,
    /// each mapped by r = √u₀, φ = 2πu₁.
    #[must_use]
    pub fn reference() -> Self {
        // State and stream that NumPy's seeding of 12345 gives, in the form that the constructor takes.
        const STATE: u128 = 0xb5ae_6482_a03d_837c_bbe2_996f_fa1f_7a2f;
        const STREAM: u128 = 0x64e3_9a9f_3715_8f94_3ebb_0f96_a013_fd73;
        Protocol::draw(Pcg64::new(STATE, STREAM), Self::PAIRS)
    }

    /// `pairs` pairs by a seed of one's own.
    #[must_use]
    pub fn seeded(seed: u64, pairs: usize) -> Self {
        Protocol::draw(Pcg64::seed_from_u64(seed), pairs)
    }

    /// The pairs with light and view exchanged.
    #[must_use]
    pub fn exchanged(&self) -> Self {
        Protocol { light: self.view.clone(), view: self.light.clone() }
    }

    /// The pairs with either direction more than [`GRAZING_DEGREES`] from the normal, and the others.
    #[must_use]
    pub fn by_elevation(&self) -> [Self; 2] {
        let least = GRAZING_DEGREES.to_radians().cos();
        let pairs = self.light.iter().copied().zip(self.view.iter().copied());
        let (grazing, rest): (Vec<_>, Vec<_>) = pairs.partition(|(light, view)| light.z.min(view.z) < least);
        [grazing, rest].map(|pairs| {
            let (light, view) = pairs.into_iter().unzip();
            Protocol { light, view }
        })
    }

    /// How many pairs there are.
    #[must_use]
    pub fn pairs(&self) -> usize {
        self.light.len()
    }

    fn draw(mut rng: Pcg64, pairs: usize) -> Self {
        let mut direction = || {
            let (u, phi) = (uniform(&mut rng), std::f64::consts::TAU * uniform(&mut rng));
            let r = u.sqrt();
            Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, (1.0 - u).sqrt() as f32)
        };
        let (view, light) = (0..pairs).map(|_| (direction(), direction())).unzip();
        Protocol { light, view }
    }
}

/// A double in [0, 1), as NumPy makes it from 64 bits.
fn uniform(rng: &mut impl Rng) -> f64 {
    (rng.random::<u64>() >> 11) as f64 / (1u64 << 53) as f64
}

/// How far one BRDF is from another; means over pairs and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BrdfError {
    /// Mean of 2|f − g|/(|f| + |g|), from 0 to 2; pairs with both below 1e-8 count 0.
    pub smape: f64,
    /// Mean of |ln(1 + cosθ_l f) − ln(1 + cosθ_l g)|.
    pub log_mae: f64,
    /// Mean of the square of the same difference.
    pub log_mse: f64,
    /// Mean of |f − g| cosθ_l.
    pub mae: f64,
    /// Root of the mean of the square of the same difference.
    pub rmse: f64,
}

/// Values below this are darkness on both sides.
const DARK: f64 = 1e-8;

/// Pairs that are evaluated and summed at a time: the sums do not depend on the threads.
const CHUNK: usize = 16_384;

impl BrdfError {
    /// Of `model` against `truth`, where that has data; 0 if it has none.
    #[must_use]
    pub fn measure(truth: &dyn Brdf, model: &dyn Brdf, protocol: &Protocol) -> Self {
        BrdfError::measure_counted(truth, model, protocol).0
    }

    /// The same, and how many pairs it is over.
    #[must_use]
    pub fn measure_counted(truth: &dyn Brdf, model: &dyn Brdf, protocol: &Protocol) -> (Self, usize) {
        let chunks = protocol.light.par_chunks(CHUNK).zip(protocol.view.par_chunks(CHUNK));
        let sums: Vec<([f64; 5], usize)> = chunks
            .map(|(light, view)| {
                let pairs = light.iter().copied().zip(view.iter().copied());
                let (light, view): (Vec<Vec3>, Vec<Vec3>) =
                    pairs.filter(|&(light, view)| truth.has_data(light, view)).unzip();
                let mut values = [vec![Vec3::ZERO; light.len()], vec![Vec3::ZERO; light.len()]];
                truth.eval_batch(&light, &view, &mut values[0]);
                model.eval_batch(&light, &view, &mut values[1]);
                (sum_errors(&light, &values[0], &values[1]), light.len())
            })
            .collect();
        let (sums, counts): (Vec<_>, Vec<usize>) = sums.into_iter().unzip();
        let pairs = counts.iter().sum();
        (BrdfError::of_sums(&sums, pairs), pairs)
    }

    /// Of `model` against scattered samples: means over these, each counting the same.
    ///
    /// # Panics
    /// If the three slices differ in length.
    #[must_use]
    pub fn at_samples(light: &[Vec3], view: &[Vec3], f: &[Vec3], model: &dyn Brdf) -> Self {
        let mut values = vec![Vec3::ZERO; light.len()];
        model.eval_batch(light, view, &mut values);
        BrdfError::of_sums(&[sum_errors(light, f, &values)], light.len())
    }

    /// The error over two sets of pairs together, each with its number of pairs.
    #[must_use]
    pub fn over_both([(a, a_count), (b, b_count)]: [(Self, usize); 2]) -> Self {
        let counts = [a_count, b_count];
        let total = (counts[0] + counts[1]).max(1) as f64;
        let mean = |a: f64, b: f64| (a * counts[0] as f64 + b * counts[1] as f64) / total;
        BrdfError {
            smape: mean(a.smape, b.smape),
            log_mae: mean(a.log_mae, b.log_mae),
            log_mse: mean(a.log_mse, b.log_mse),
            mae: mean(a.mae, b.mae),
            rmse: mean(a.rmse * a.rmse, b.rmse * b.rmse).sqrt(),
        }
    }

    fn of_sums(sums: &[[f64; 5]], pairs: usize) -> Self {
        let count = (pairs.max(1) * 3) as f64;
        let mean = |i: usize| sums.iter().map(|s| s[i]).sum::<f64>() / count;
        BrdfError { smape: mean(0), log_mae: mean(1), log_mse: mean(2), mae: mean(3), rmse: mean(4).sqrt() }
    }
}

fn sum_errors(light: &[Vec3], truth: &[Vec3], model: &[Vec3]) -> [f64; 5] {
    let mut sums = [0.0; 5];
    for ((light, f), g) in light.iter().zip(truth).zip(model) {
        let cos = f64::from(light.z);
        for (f, g) in f.as_dvec3().to_array().into_iter().zip(g.as_dvec3().to_array()) {
            let difference = (f - g).abs();
            if f.max(g) >= DARK {
                sums[0] += 2.0 * difference / (f + g);
            }
            let log = ((1.0 + cos * f) / (1.0 + cos * g)).ln();
            sums[1] += log.abs();
            sums[2] += log * log;
            sums[3] += difference * cos;
            sums[4] += difference * difference * cos * cos;
        }
    }
    sums
}

/// A BRDF with light and view exchanged: against the original it is a measurement's own noise.
pub struct Swapped<'a>(pub &'a dyn Brdf);

impl Brdf for Swapped<'_> {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        self.0.eval(view, light)
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        self.0.eval_batch(view, light, out);
    }

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        self.0.has_data(view, light)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Constant(f32);

    impl Brdf for Constant {
        fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
            Vec3::splat(self.0)
        }
    }

    #[test]
    fn reference_pairs_are_those_of_numpy() {
        let protocol = Protocol::reference();
        // numpy.random.default_rng(12345).random((2, 4))
        let u = [
            [0.227_336_02, 0.316_758_34, 0.797_365_46, 0.676_254_67],
            [0.391_109_55, 0.332_813_93, 0.598_308_75, 0.186_734_19],
        ];
        for (i, u) in u.iter().enumerate() {
            for (direction, u) in [(protocol.view[i], &u[..2]), (protocol.light[i], &u[2..])] {
                let (r, phi) = (f64::sqrt(u[0]), std::f64::consts::TAU * u[1]);
                let expected =
                    Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, (1.0 - u[0]).sqrt() as f32);
                assert!((direction - expected).length() < 1e-6, "pair {i}: {direction} against {expected}");
            }
        }
        assert_eq!(protocol.light.len(), Protocol::PAIRS);
    }

    #[test]
    fn constants_have_the_errors_that_paper_and_pencil_give() {
        let error = BrdfError::measure(&Constant(1.0), &Constant(3.0), &Protocol::seeded(1, 200_000));
        assert!((error.smape - 1.0).abs() < 1e-6);
        // Cosine-distributed light: E[c] = 2/3, E[c²] = 1/2.
        assert!((error.mae - 4.0 / 3.0).abs() < 4e-3, "{}", error.mae);
        assert!((error.rmse - 2.0f64.sqrt()).abs() < 4e-3, "{}", error.rmse);
        // E[ln((1+3c)/(1+c))] with density 2c: ∫ 2c (ln(1+3c) − ln(1+c)) dc.
        assert!((error.log_mae - 0.565_595).abs() < 3e-3, "{}", error.log_mae);
        assert!(error.log_mse > error.log_mae * error.log_mae);
    }

    #[test]
    fn grazing_pairs_and_the_others_are_all_pairs() {
        let protocol = Protocol::seeded(3, 100_000);
        let parts = protocol.by_elevation();
        let counts = parts.each_ref().map(Protocol::pairs);
        // Either of two directions: 1 − (1 − cos² 75°)².
        assert!((counts[0] as f64 / 1e5 - 0.129_5).abs() < 4e-3, "{counts:?}");
        let (truth, model) = (Constant(1.0), Constant(3.0));
        let errors = parts.each_ref().map(|part| BrdfError::measure_counted(&truth, &model, part));
        assert!(errors[0].0.mae < errors[1].0.mae);
        assert_eq!(errors.map(|(_, pairs)| pairs), counts);
        let whole = BrdfError::measure(&truth, &model, &protocol);
        let both = BrdfError::over_both(errors);
        for (a, b) in [(whole.mae, both.mae), (whole.rmse, both.rmse), (whole.smape, both.smape)] {
            assert!((a - b).abs() < 1e-9, "{whole:?} {both:?}");
        }
    }

    #[test]
    fn pairs_without_data_count_nothing() {
        /// Known where the light is on one side, and far off elsewhere.
        struct Half;
        impl Brdf for Half {
            fn eval(&self, light: Vec3, _: Vec3) -> Vec3 {
                Vec3::splat(if light.x > 0.0 { 1.0 } else { 1e6 })
            }

            fn has_data(&self, light: Vec3, _: Vec3) -> bool {
                light.x > 0.0
            }
        }
        let protocol = Protocol::seeded(4, 20_000);
        let (error, pairs) = BrdfError::measure_counted(&Half, &Constant(3.0), &protocol);
        assert!((error.smape - 1.0).abs() < 1e-6 && (error.mae - 4.0 / 3.0).abs() < 2e-2, "{error:?}");
        assert!(pairs.abs_diff(10_000) < 500, "{pairs}");
        let (error, pairs) = BrdfError::measure_counted(&Swapped(&Half), &Constant(3.0), &protocol);
        assert!(error.mae < 2.0 && pairs < 10_500, "{error:?} {pairs}");
    }

    #[test]
    fn samples_count_alike_wherever_they_are() {
        let light = [Vec3::Z, Vec3::new(0.6, 0.0, 0.8)];
        let f = [Vec3::splat(1.0), Vec3::splat(3.0)];
        let error = BrdfError::at_samples(&light, &light, &f, &Constant(3.0));
        assert!((error.smape - 0.5).abs() < 1e-6 && (error.mae - 1.0).abs() < 1e-6, "{error:?}");
    }

    #[test]
    fn darkness_and_agreement_count_nothing() {
        let protocol = Protocol::seeded(2, 1000);
        assert_eq!(BrdfError::measure(&Constant(0.4), &Constant(0.4), &protocol), BrdfError::default());
        assert_eq!(BrdfError::measure(&Constant(1e-9), &Constant(0.0), &protocol).smape, 0.0);
    }
}
