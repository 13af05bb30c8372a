//! A study: models against measurements, in error and in cost. What `glimt report` measures, and what its page,
//! tables and plots are made of.
//!
//! A [`Candidate`] is a model with its cost; a [`Subject`] a measured material with what it is itself; a [`Case`] one
//! against the other. Cases are measured one by one and can be kept: nothing in them depends on the others.

pub mod curves;
pub mod frames;
pub mod light;
pub mod noise;
pub mod pareto;
pub mod picture;
mod sequence;
pub mod sphere;

use std::collections::BTreeMap;

use glimt_core::{Brdf, Material};
use glimt_image::Image;
use serde::{Deserialize, Serialize};

use crate::brdf_error::{BrdfError, Protocol};
use crate::error::Error;
use crate::image::difference::Difference;
use crate::image::exposure::automatic;
use crate::image::flip::{self, flip};
use curves::{AlbedoProbes, slices};
use frames::Frames;
use light::Light;
use noise::{Chosen, variance};
use picture::Picture;
use sphere::LitSphere;

/// How everything is measured. A kept [`Case`] is good as long as this is the same.
#[derive(Clone, Debug, Serialize)]
pub struct Settings {
    /// Seed of all random numbers but those of the reference pairs.
    pub seed: u64,
    /// Pairs of directions of the errors in BRDF space.
    pub pairs: usize,
    /// Pixels across a sphere.
    pub size: usize,
    /// Directions a pixel where a light has to be sampled.
    pub directions: usize,
    /// Lights by their names.
    pub lights: Vec<String>,
}

/// A study as a whole.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Who made it, how, when and where.
    pub made: Made,
    /// How it was measured.
    pub settings: Settings,
    /// The models; the measurement itself is not among them.
    pub candidates: Vec<Candidate>,
    /// The materials.
    pub subjects: Vec<Subject>,
    /// Whole frames in a renderer, where they were asked for.
    pub frames: Option<Frames>,
}

/// Who made a study, how, when and where: what every figure carries.
#[derive(Clone, Debug, Serialize)]
pub struct Made {
    /// The command.
    pub command: String,
    /// Version of glimt.
    pub glimt: String,
    /// Processor.
    pub cpu: String,
    /// Instruction set that kernels used.
    pub instruction_set: String,
    /// Date, UTC.
    pub date: String,
}

/// A model with its cost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Candidate {
    /// What it is called, unique in a study.
    pub name: String,
    /// Model.
    pub kind: String,
    /// The network's hidden layers, as in 32x2; – where there is none.
    pub net: String,
    /// File, as the command named it.
    pub file: String,
    /// SHA-256 of the file, or of all files.
    pub sha256: String,
    /// The command that made it, where it is known.
    pub command: String,
    /// Materials in the file.
    pub materials: usize,
    /// Bytes of tensors that a material has of its own.
    pub own_bytes: usize,
    /// Bytes of tensors that all share.
    pub shared_bytes: usize,
    /// Seconds that the fit took on this machine, all materials together, where it was watched.
    pub fit_seconds: Option<f64>,
    /// Times of one core by way (batch, single, …), in ns.
    pub times: BTreeMap<String, Time>,
}

impl Candidate {
    /// Bytes that a material costs in this library, its share of what is shared included.
    #[must_use]
    pub fn bytes_per_material(&self) -> f64 {
        self.own_bytes as f64 + self.shared_bytes as f64 / self.materials.max(1) as f64
    }
}

/// A time for one pair, in ns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Median of the rounds.
    pub median: f64,
    /// Quartiles of the rounds.
    pub quartiles: [f64; 2],
}

/// The name of the measurement where it stands beside models.
pub const MEASUREMENT: &str = "measurement";

/// A measured material: what the models are held against.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Subject {
    /// Its name.
    pub name: String,
    /// File, as the command named it.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Format or model.
    pub format: String,
    /// Its own noise: f(light, view) against f(view, light).
    pub noise: Errors,
    /// Noise of the images: the truth against itself with another seed.
    pub image_noise: Vec<ImageError>,
    /// See [`slices`].
    pub slices: Vec<Vec<f32>>,
    /// See [`AlbedoProbes::albedo`].
    pub albedo: Vec<f64>,
    /// Variance by sampler, see [`variance`].
    pub variance: BTreeMap<String, Vec<f64>>,
    /// Its sphere under every light.
    pub spheres: Vec<Picture>,
    /// The models.
    pub cases: Vec<Case>,
}

/// Errors in BRDF space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Over all pairs.
    pub all: BrdfError,
    /// Over pairs with a grazing direction, see [`crate::brdf_error::GRAZING_DEGREES`].
    pub grazing: BrdfError,
    /// Over the others.
    pub rest: BrdfError,
    /// Over all pairs, with light and view exchanged in both.
    pub exchanged: BrdfError,
}

/// Error of an image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageError {
    /// By pixel and by window.
    #[serde(flatten)]
    pub difference: Difference,
    /// Mean ꟻLIP at the truth's exposure.
    pub flip: f64,
    /// Mean HDR-ꟻLIP.
    pub hdr_flip: f64,
}

/// A model against a material.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Case {
    /// The candidate's name.
    pub candidate: String,
    /// Errors in BRDF space.
    pub errors: Errors,
    /// Errors of the sphere's image under every light.
    pub images: Vec<ImageError>,
    /// See [`slices`].
    pub slices: Vec<Vec<f32>>,
    /// See [`AlbedoProbes::albedo`].
    pub albedo: Vec<f64>,
    /// Variance of the model under its own sampler, see [`variance`].
    pub variance: Vec<f64>,
    /// Sphere, difference and ꟻLIP map under every light.
    pub pictures: Vec<[Picture; 3]>,
}

/// Factor by which differences are multiplied before they are shown.
pub const DIFFERENCE_SCALE: f32 = 4.0;

/// Pixels across the spheres of which the variance is measured.
const NOISE_SIZE: usize = 32;

/// A material with everything that its models are held against: made once for all of them.
pub struct Bench<'a> {
    truth: &'a Material,
    settings: &'a Settings,
    /// Pairs with a grazing direction, and the others.
    pairs: [Protocol; 2],
    exchanged: Protocol,
    spheres: Vec<LitSphere>,
    images: Vec<Image>,
    exposures: Vec<f32>,
    albedo: AlbedoProbes,
}

impl<'a> Bench<'a> {
    /// Renders the truth and draws all directions.
    ///
    /// # Errors
    /// Those of images.
    pub fn new(truth: &'a Material, lights: &[Light], settings: &'a Settings) -> Result<Self, Error> {
        let protocol = if settings.pairs == Protocol::PAIRS {
            Protocol::reference()
        } else {
            Protocol::seeded(settings.seed, settings.pairs)
        };
        let &Settings { seed, size, directions, .. } = settings;
        let spheres: Vec<LitSphere> =
            lights.iter().map(|light| LitSphere::new(truth, light, size, directions, seed)).collect();
        let images: Vec<Image> = spheres.iter().map(|sphere| sphere.render(truth)).collect();
        let exposures = images.iter().map(|image| automatic(image)).collect::<Result<_, _>>()?;
        Ok(Bench {
            pairs: protocol.by_elevation(),
            exchanged: protocol.exchanged(),
            albedo: AlbedoProbes::new(truth, seed),
            truth,
            settings,
            spheres,
            images,
            exposures,
        })
    }

    fn errors(&self, brdf: &dyn Brdf) -> Errors {
        let errors = self.pairs.each_ref().map(|pairs| BrdfError::measure_counted(self.truth, brdf, pairs));
        let [grazing, rest] = errors.map(|(error, _)| error);
        let all = BrdfError::over_both(errors);
        Errors { all, grazing, rest, exchanged: BrdfError::measure(self.truth, brdf, &self.exchanged) }
    }

    /// What the material is itself. `warp` names its own sampler.
    ///
    /// # Errors
    /// Those of images.
    pub fn subject(&self, lights: &[Light]) -> Result<Subject, Error> {
        let &Settings { seed, size, directions, .. } = self.settings;
        let mut image_noise = Vec::new();
        let mut pictures = Vec::new();
        for (i, light) in lights.iter().enumerate() {
            // Any other seed will do.
            let again = LitSphere::new(self.truth, light, size, directions, !seed).render(self.truth);
            image_noise.push(self.image_error(i, &again, |_, _| ())?);
            pictures.push(Picture::shown(&self.images[i], self.exposures[i]));
        }
        Ok(Subject {
            name: String::new(),
            file: String::new(),
            sha256: String::new(),
            format: String::new(),
            noise: self.errors(&crate::brdf_error::Swapped(self.truth)),
            image_noise,
            slices: slices(self.truth),
            albedo: self.albedo.albedo(self.truth),
            variance: self.samplers(),
            spheres: pictures,
            cases: Vec::new(),
        })
    }

    /// Variance of the truth under every sampler that there is for it.
    fn samplers(&self) -> BTreeMap<String, Vec<f64>> {
        use glimt_core::sampling::SamplerChoice::{Lobes, Table};
        let seed = self.settings.seed;
        let of = |material: &Material| variance(material, Chosen::By(material), NOISE_SIZE, seed);
        let own = self.truth.plan().name().to_owned();
        let mut variances = BTreeMap::from([
            ("cosine".to_owned(), variance(self.truth, Chosen::Cosine, NOISE_SIZE, seed)),
            (own, of(self.truth)),
        ]);
        for choice in [Lobes, Table(glimt_core::sampling::table::Resolution::DEFAULT)] {
            let material = self.truth.with_sampler(choice);
            variances.entry(material.plan().name().to_owned()).or_insert_with(|| of(&material));
        }
        variances
    }

    fn image_error(
        &self,
        light: usize,
        image: &Image,
        row: impl FnMut(usize, &[f32]),
    ) -> Result<ImageError, Error> {
        let (truth, exposure) = (&self.images[light], self.exposures[light]);
        Ok(ImageError {
            difference: Difference::measure(truth, image, Some(exposure))?,
            flip: flip(truth, image, flip::Shown::Exposed(exposure), row)?,
            hdr_flip: flip(truth, image, flip::Shown::AllExposures, |_, _| ())?,
        })
    }

    /// Measures a model.
    ///
    /// # Errors
    /// Those of images.
    pub fn case(&self, candidate: &str, model: &Material) -> Result<Case, Error> {
        let mut images = Vec::new();
        let mut pictures = Vec::new();
        for (i, sphere) in self.spheres.iter().enumerate() {
            let image = sphere.render(model);
            let mut map = Vec::new();
            images.push(self.image_error(i, &image, |_, errors| map.extend_from_slice(errors))?);
            pictures.push([
                Picture::shown(&image, self.exposures[i]),
                Picture::difference(&self.images[i], &image, self.exposures[i] * DIFFERENCE_SCALE),
                Picture::map(&map, &image),
            ]);
        }
        Ok(Case {
            candidate: candidate.to_owned(),
            errors: self.errors(model),
            images,
            slices: slices(model),
            albedo: self.albedo.albedo(model),
            variance: variance(model, Chosen::By(model), NOISE_SIZE, self.settings.seed),
            pictures,
        })
    }
}

impl Study {
    /// The candidate of that name.
    #[must_use]
    pub fn candidate(&self, name: &str) -> Option<&Candidate> {
        self.candidates.iter().find(|candidate| candidate.name == name)
    }

    /// The cases of a candidate, over all materials that it has.
    pub fn cases<'a>(&'a self, candidate: &'a Candidate) -> impl Iterator<Item = &'a Case> {
        self.subjects
            .iter()
            .flat_map(|subject| &subject.cases)
            .filter(|case| case.candidate == candidate.name)
    }

    /// The mean of a figure over all materials that a candidate has; NaN if it has none.
    pub fn mean(&self, candidate: &Candidate, figure: impl Fn(&Case) -> f64) -> f64 {
        let values: Vec<f64> = self.cases(candidate).map(figure).collect();
        values.iter().sum::<f64>() / values.len() as f64
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::frames::Frame;
    use super::*;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;

    fn material(alpha: f32) -> Material {
        Ggx::new(Microfacet { kd: [0.4, 0.2, 0.1], eta: [1.5; 3], alpha: [alpha; 2] }).unwrap().into()
    }

    fn frames() -> Frames {
        let frame = |spp: f64| {
            let noise = 1.0 / spp.sqrt();
            Frame { spp, seconds: 0.01 * spp, rmse: noise + 0.1, noise }
        };
        let names = [MEASUREMENT, "same", "same, table", "stock"];
        let curves = names.map(|name| (name.to_owned(), vec![frame(1.0), frame(16.0)]));
        let variants = BTreeMap::from([("scalar_rgb".to_owned(), curves.into())]);
        Frames { material: "brass <raw>".into(), scenes: [("sphere".to_owned(), variants)].into() }
    }

    /// A study of one material and two models, the first of which is the truth.
    pub(crate) fn small() -> Study {
        let lights = [Light::lamps(), Light::studio()];
        let settings = Settings {
            seed: 1,
            pairs: 4000,
            size: 24,
            directions: 512,
            lights: lights.iter().map(|light| light.name().to_owned()).collect(),
        };
        let truth = material(0.2);
        let bench = Bench::new(&truth, &lights, &settings).unwrap();
        let mut subject = bench.subject(&lights).unwrap();
        subject.name = "brass <raw>".into();
        subject.cases = [("same", 0.2), ("other", 0.6)]
            .map(|(name, alpha)| bench.case(name, &material(alpha)).unwrap())
            .into();
        let candidate = |name: &str, ns: f64| Candidate {
            name: name.into(),
            kind: "ggx".into(),
            net: String::new(),
            file: "a.safetensors".into(),
            sha256: String::new(),
            command: "glimt fit".into(),
            materials: 1,
            own_bytes: 28,
            shared_bytes: 0,
            fit_seconds: None,
            times: BTreeMap::from([("batch".into(), Time { median: ns, quartiles: [ns; 2] })]),
        };
        Study {
            made: Made {
                command: "glimt report \"a & b\"".into(),
                glimt: "0".into(),
                cpu: "a processor".into(),
                instruction_set: "portable".into(),
                date: "2000-02-29".into(),
            },
            settings,
            candidates: vec![candidate("same", 8.0), candidate("other", 4.0)],
            subjects: vec![subject],
            frames: Some(frames()),
        }
    }

    #[test]
    fn the_truth_has_no_error_and_another_model_has() {
        let study = small();
        let [same, other] = &study.subjects[0].cases[..] else { panic!("two cases") };
        assert_eq!(same.errors, Errors::default());
        for image in &same.images {
            assert_eq!((image.difference.mae, image.flip, image.hdr_flip), (0.0, 0.0, 0.0));
        }
        assert!(other.errors.all.smape > 0.01 && other.images.iter().all(|image| image.flip > 1e-3));
        assert!(study.mean(&study.candidates[1], |case| case.errors.all.smape) > 0.01);
    }

    #[test]
    fn a_subject_is_read_as_it_was_written() {
        let subject = small().subjects.remove(0);
        assert_eq!(subject.cases[0].images[0].difference.psnr, f64::INFINITY);
        let text = serde_json::to_string(&subject).unwrap();
        let read: Subject = serde_json::from_str(&text).unwrap();
        assert_eq!(read.cases[0].images[0].difference.psnr, f64::INFINITY);
    }

    #[test]
    fn another_seed_changes_images_by_less_than_another_model() {
        let study = small();
        let subject = &study.subjects[0];
        assert_eq!(subject.image_noise[0].difference.mae, 0.0);
        let [noise, error] = [subject.image_noise[1], subject.cases[1].images[1]].map(|e| e.difference);
        assert!(noise.mae < error.mae, "{noise:?} against {error:?}");
        assert_eq!(subject.noise.all.smape, 0.0, "a microfacet model is reciprocal");
    }
}
