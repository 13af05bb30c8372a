//! RGL material database (`.bsdf`): the adaptive parameterization of Dupuy & Jakob, *An Adaptive
//! Parameterization for Efficient Material Acquisition and Rendering*, 2018.
//!
//! The file tabulates, for view directions (φ, θ), how f varies over a square that is warped so that
//! uniform samples follow the material's microfacets:
//!
//! - a half vector (θ_m, φ_m) maps to u_m = (√(2θ_m/π), φ_m/2π + ½), φ_m counted from the view
//!   direction if the material is isotropic;
//! - `vndf` is the density of visible normals over u_m; its [`Warp`] takes the table's square to u_m;
//! - `rgb` or `spectra` tabulate the reflectance S over the square of the warp;
//! - `ndf` is the distribution of normals D over u_m and `sigma` the projected area σ of the
//!   microfacets over the view direction (mapped as u_m).
//!
//! With the `jacobian` flag, f(light, view) · cosθ_light = S · D(u_m) / (4 σ(view)), otherwise = S.
//! The database calls `wi` what is the view here.
//!
//! The interpolated S can be negative in saturated colours; f is 0 there, as in the database's own
//! reader (Mitsuba returns the negative number). Files of the database itself hold densities a hair below 0,
//! which count as 0 too, and a projected area of 0 is filled from its neighbours, as it would divide f.

use std::f32::consts::{FRAC_1_PI, FRAC_2_PI, FRAC_PI_2, PI, TAU};
use std::path::Path;

use glam::{Vec2, Vec3, Vec4};
use glimt_core::models::tabulated::Table;
use glimt_core::sampling::DirectionSampler;
use glimt_core::{Brdf, Oddity, is_lit};

use crate::error::Error;
use crate::file;
use crate::grid::{Blend, Directions, Extent, Grid};
use crate::holes::{self, Axis};
use crate::spectrum;
use crate::tensor::{DType, Field, TensorFile};
use crate::warp::Warp;

/// f is S·D/4σ over the cosine; below this cosine (6·10⁻⁵ degrees from the horizon) the quotient
/// would overflow, and the cosine counts as this.
const MIN_COS_THETA: f32 = 1e-6;
/// The density has a pole where the half vector is the normal. Closer to it than 10⁻⁷ rad, where
/// float32 directions cannot tell the two apart, the Jacobian (31 u³ there) stays at this. Mitsuba
/// stops at 10⁻⁶, within which 0.3 % of the unit square lies: too much for an exact density.
const MIN_JACOBIAN: f32 = 5e-10;

/// A measurement of the RGL material database, isotropic or anisotropic, in linear sRGB.
///
/// Spectral files are converted once, at load ([`crate::spectrum`]).
#[derive(Clone, Debug)]
pub struct Rgl {
    name: String,
    description: String,
    oddities: Vec<Oddity>,
    symmetry: Symmetry,
    /// Whether the tables leave out D/4σ ("jacobian" in the file).
    jacobian: bool,
    directions: Directions,
    ndf: Grid<f32>,
    sigma: Grid<f32>,
    vndf: Warp,
    luminance: Warp,
    /// Linear sRGB and one lane of padding.
    reflectance: Grid<Vec4>,
}

/// Which view azimuths were measured; the others follow by symmetry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Symmetry {
    /// Any rotation about the normal.
    Isotropic,
    /// None: the whole circle.
    None,
    /// Rotation by 180°: φ in [−180°, 0°].
    HalfTurn,
    /// Mirrors x → −x and y → −y: φ in [−180°, −90°].
    Quadrant,
}

impl Symmetry {
    /// The factor of x and y that brings `view` among the measured azimuths.
    #[inline]
    fn fold(self, view: Vec3) -> Vec2 {
        let to_negative = |x: f32| if x.is_sign_negative() { 1.0 } else { -1.0 };
        match self {
            Symmetry::Isotropic | Symmetry::None => Vec2::ONE,
            Symmetry::HalfTurn => Vec2::splat(to_negative(view.y)),
            Symmetry::Quadrant => Vec2::new(to_negative(view.x), to_negative(view.y)),
        }
    }
}

/// The tables' coordinates of a pair of directions.
struct Lookup {
    /// Half vector in the unit square.
    u_half: Vec2,
    /// View direction in the unit square.
    u_view: Vec2,
    /// Slices around the view direction.
    blend: Blend,
    half: Vec3,
    /// The view direction, folded.
    view: Vec3,
}

/// The view direction in the tables' terms.
struct View {
    /// Folded to the measured azimuths.
    direction: Vec3,
    theta: f32,
    phi: f32,
}

impl Rgl {
    /// Reads a `.bsdf` file.
    ///
    /// # Errors
    /// [`Error::Read`], and those of [`Rgl::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<Rgl, Error> {
        let path = path.as_ref();
        Rgl::from_bytes(path, &file::read(path)?)
    }

    /// Decodes the bytes of a `.bsdf` file; `path` gives the material's name and that in errors.
    ///
    /// # Errors
    /// [`Error::Invalid`] or [`Error::Size`] for a broken container, a missing field, one of a wrong
    /// type or shape, for values that are not finite, and where no area is above 0.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Rgl, Error> {
        let (file, trailing) = TensorFile::parse(path, bytes)?;
        let fields = Fields { path, file };
        let phi = fields.knots("phi_i")?;
        let theta = fields.knots("theta_i")?;
        let slices = [phi.len(), theta.len()];
        let symmetry = fields.symmetry(&phi)?;
        let mut oddities = Vec::new();
        let (ndf_extent, ndf) = fields.density("ndf", &[], &mut oddities)?;
        let (sigma_extent, sigma) = fields.areas("sigma", &mut oddities)?;
        let (vndf_extent, vndf) = fields.density("vndf", &slices, &mut oddities)?;
        let (luminance_extent, luminance) = fields.density("luminance", &slices, &mut oddities)?;
        let (reflectance_extent, reflectance) = fields.reflectance(slices, &mut oddities)?;
        oddities.push(Oddity::Trailing { bytes: trailing });
        oddities.retain(Oddity::is_there);

        Ok(Rgl {
            name: material_name(path),
            description: fields.description()?,
            oddities,
            symmetry,
            jacobian: fields.flag("jacobian")?,
            directions: Directions::new(phi, theta),
            ndf: Grid::new(ndf_extent, ndf),
            sigma: Grid::new(sigma_extent, sigma),
            vndf: Warp::new(vndf_extent, &vndf),
            luminance: Warp::new(luminance_extent, &luminance),
            reflectance: Grid::new(reflectance_extent, reflectance),
        })
    }

    /// File name without extension and without the `_rgb` or `_spec` of the database.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    #[inline]
    fn view(&self, view: Vec3) -> View {
        let direction = view * self.symmetry.fold(view).extend(1.0);
        View { direction, theta: elevation(direction), phi: direction.y.atan2(direction.x) }
    }

    #[inline]
    fn lookup(&self, light: Vec3, view: Vec3) -> Lookup {
        let light = light * self.symmetry.fold(view).extend(1.0);
        let view = self.view(view);
        let half = (light + view.direction).normalize_or_zero();
        let phi_half = half.y.atan2(half.x);
        let phi = if self.is_isotropic() { phi_half - view.phi } else { phi_half };
        let u_phi = u_of_phi(phi);
        Lookup {
            u_half: Vec2::new(u_of_theta(elevation(half)), u_phi - u_phi.floor()),
            u_view: Vec2::new(u_of_theta(view.theta), u_of_phi(view.phi)),
            blend: self.directions.blend(view.phi, view.theta),
            half,
            view: view.direction,
        }
    }

    /// f · cosθ_light, from the point `sample` of the reflectance table.
    #[inline]
    fn f_cos(&self, lookup: &Lookup, sample: Vec2) -> Vec3 {
        let reflectance = self.reflectance.eval(sample, &lookup.blend).truncate();
        let scale = if self.jacobian {
            let ndf = self.ndf.eval(lookup.u_half, &Blend::SINGLE);
            ndf / (4.0 * self.sigma.eval(lookup.u_view, &Blend::SINGLE))
        } else {
            1.0
        };
        reflectance.max(Vec3::ZERO) * scale
    }

    /// Solid angle of the light per area of the square of u_m: dω_m/du_m · dω_light/dω_m.
    #[inline]
    fn solid_angle(u_half: Vec2, half: Vec3, view: Vec3) -> f32 {
        let normals = 2.0 * PI * PI * u_half.x * half.truncate().length();
        normals.max(MIN_JACOBIAN) * 4.0 * view.dot(half)
    }
}

impl Brdf for Rgl {
    #[inline]
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let lookup = self.lookup(light, view);
        let (sample, _) = self.vndf.invert(lookup.u_half, &lookup.blend);
        let f = self.f_cos(&lookup, sample) / light.z.max(MIN_COS_THETA);
        // Directions far from unit length can overflow the half vector.
        if f.is_finite() { f } else { Vec3::ZERO }
    }
}

impl Table for Rgl {
    fn format(&self) -> &'static str {
        "rgl"
    }

    fn grid(&self) -> String {
        let (views, Extent { width, height }) = (self.directions.count(), self.reflectance.extent());
        format!("{views} views of {width} × {height} values")
    }

    /// What the database says about the material.
    fn description(&self) -> &str {
        &self.description
    }

    fn is_isotropic(&self) -> bool {
        self.symmetry == Symmetry::Isotropic
    }

    fn is_reciprocal(&self) -> bool {
        false
    }

    /// Where the interpolation of the table gives a negative reflectance, f is 0 too.
    fn oddities(&self) -> &[Oddity] {
        &self.oddities
    }
}

impl DirectionSampler for Rgl {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if !is_lit(light, view) {
            return 0.0;
        }
        let lookup = self.lookup(light, view);
        let (sample, vndf) = self.vndf.invert(lookup.u_half, &lookup.blend);
        let luminance = self.luminance.pdf(sample, &lookup.blend);
        let pdf = vndf * luminance / Rgl::solid_angle(lookup.u_half, lookup.half, lookup.view);
        // View and half vector can round to a right angle, or past it, at the horizon.
        if pdf.is_finite() { pdf.max(0.0) } else { 0.0 }
    }

    /// The database's own sampling: `u.y` and `u.z` are warped by the luminance of the reflectance
    /// table, then by the visible normals; `u.x` is not needed.
    fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        if !is_lit(view, view) {
            return None;
        }
        let fold = self.symmetry.fold(view).extend(1.0);
        let View { direction, theta, phi } = self.view(view);
        let blend = self.directions.blend(phi, theta);
        let (sample, luminance) = self.luminance.sample(Vec2::new(u.z, u.y), &blend);
        let (u_half, vndf) = self.vndf.sample(sample, &blend);

        let phi_half = (2.0 * u_half.y - 1.0) * PI + if self.is_isotropic() { phi } else { 0.0 };
        let theta_half = u_half.x * u_half.x * FRAC_PI_2;
        let (sin_theta, cos_theta) = theta_half.sin_cos();
        let (sin_phi, cos_phi) = phi_half.sin_cos();
        let half = Vec3::new(cos_phi * sin_theta, sin_phi * sin_theta, cos_theta);
        let light = (2.0 * direction.dot(half) * half - direction).normalize_or_zero();
        let pdf = vndf * luminance / Rgl::solid_angle(u_half, half, direction);
        (light.z > 0.0 && pdf > 0.0 && pdf.is_finite()).then_some((light * fold, pdf))
    }
}

/// Angle between a unit vector and the normal in radians; exact near the normal, where
/// the arc cosine of z has lost its digits.
#[inline]
fn elevation(d: Vec3) -> f32 {
    2.0 * (0.5 * (d - Vec3::Z).length()).min(1.0).asin()
}

#[inline]
fn u_of_theta(theta: f32) -> f32 {
    (theta * FRAC_2_PI).sqrt()
}

#[inline]
fn u_of_phi(phi: f32) -> f32 {
    (phi + PI) * (0.5 * FRAC_1_PI)
}

/// The checked contents of a file.
struct Fields<'a> {
    path: &'a Path,
    file: TensorFile<'a>,
}

impl Fields<'_> {
    fn error(&self, name: &str, found: impl ToString, expected: impl Into<String>) -> Error {
        Error::invalid(self.path, format!("field `{name}`"), found, expected)
    }

    /// The field `name`, of this type and rank.
    fn field(&self, name: &str, dtype: DType, rank: usize) -> Result<&Field<'_>, Error> {
        let expected = || format!("a {dtype:?} tensor of rank {rank}");
        let field = self.file.get(name).ok_or_else(|| self.error(name, "nothing", expected()))?;
        if field.dtype != dtype || field.shape.len() != rank {
            let found = format!("a {:?} tensor of shape {:?}", field.dtype, field.shape);
            return Err(self.error(name, found, expected()));
        }
        Ok(field)
    }

    /// Shape and values of a float tensor; the values are finite.
    fn floats(&self, name: &str, rank: usize) -> Result<(&[usize], Vec<f32>), Error> {
        let field = self.field(name, DType::Float32, rank)?;
        let values = field.to_f32();
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            let found = format!("{} at index {at}", values[at]);
            return Err(self.error(name, found, "finite numbers"));
        }
        Ok((&field.shape, values))
    }

    /// Positions of slices: strictly increasing, at least one.
    fn knots(&self, name: &str) -> Result<Vec<f32>, Error> {
        let (_, knots) = self.floats(name, 1)?;
        const EXPECTED: &str = "strictly increasing numbers";
        if knots.is_empty() {
            return Err(self.error(name, "none", EXPECTED));
        }
        if let Some(pair) = knots.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(self.error(name, format!("{} before {}", pair[0], pair[1]), EXPECTED));
        }
        Ok(knots)
    }

    /// A tensor over `leading` slices of a square with at least 2 × 2 knots.
    fn slices(&self, name: &str, leading: &[usize]) -> Result<(Extent, Vec<f32>), Error> {
        let (shape, values) = self.floats(name, leading.len() + 2)?;
        let (slices, square) = shape.split_at(leading.len());
        if slices != leading || square.iter().any(|&knots| knots < 2) {
            let expected = format!("{leading:?} slices of at least 2 x 2");
            return Err(self.error(name, format!("shape {shape:?}"), expected));
        }
        Ok((Extent { width: square[1], height: square[0] }, values))
    }

    /// The same for a density; a negative one counts as 0.
    fn density(
        &self,
        name: &'static str,
        leading: &[usize],
        oddities: &mut Vec<Oddity>,
    ) -> Result<(Extent, Vec<f32>), Error> {
        let (extent, mut values) = self.slices(name, leading)?;
        oddities.push(negative(name, &values));
        values.iter_mut().for_each(|value| *value = value.max(0.0));
        Ok((extent, values))
    }

    /// A table of projected areas; those that are not above 0 are filled from their neighbours.
    fn areas(&self, name: &'static str, oddities: &mut Vec<Oddity>) -> Result<(Extent, Vec<f32>), Error> {
        let (extent, mut values) = self.slices(name, &[])?;
        let has_area: Vec<bool> = values.iter().map(|&area| area > 0.0).collect();
        if !has_area.contains(&true) {
            return Err(self.error(name, "no area above 0", "at least one, as they divide f"));
        }
        oddities.push(Oddity::NoArea { count: has_area.iter().filter(|&&has| !has).count() });
        // Azimuths run along the rows' numbers; the first and the last are the same direction.
        let axis = |length| Axis { length, is_cyclic: false };
        holes::fill(&mut values, &has_area, [axis(extent.height), axis(extent.width)]);
        Ok((extent, values))
    }

    /// The reflectance table in linear sRGB.
    fn reflectance(
        &self,
        slices: [usize; 2],
        oddities: &mut Vec<Oddity>,
    ) -> Result<(Extent, Vec<Vec4>), Error> {
        let [phi, theta] = slices;
        let (name, weights) = if self.file.get("rgb").is_some() {
            ("rgb", vec![Vec3::X, Vec3::Y, Vec3::Z])
        } else {
            let wavelengths = self.knots("wavelengths")?;
            let (from, to) = spectrum::VISIBLE;
            let (first, last) = (wavelengths[0], wavelengths[wavelengths.len() - 1]);
            if first > f32::from(to) || last < f32::from(from) {
                let expected = format!("wavelengths in nm between {from} and {to}");
                return Err(self.error("wavelengths", format!("{first} to {last}"), expected));
            }
            ("spectra", spectrum::to_srgb(&wavelengths))
        };
        let (extent, values) = self.slices(name, &[phi, theta, weights.len()])?;
        let knots = extent.knots();
        let mut reflectance = vec![Vec4::ZERO; phi * theta * knots];
        for (slice, planes) in
            reflectance.chunks_exact_mut(knots).zip(values.chunks_exact(knots * weights.len()))
        {
            for (plane, weight) in planes.chunks_exact(knots).zip(&weights) {
                for (rgb, &value) in slice.iter_mut().zip(plane) {
                    *rgb += weight.extend(0.0) * value;
                }
            }
        }
        oddities.push(negative(name, &values));
        Ok((extent, reflectance))
    }

    fn description(&self) -> Result<String, Error> {
        let field = self.field("description", DType::UInt8, 1)?;
        Ok(String::from_utf8_lossy(&field.data).into_owned())
    }

    fn flag(&self, name: &str) -> Result<bool, Error> {
        let field = self.field(name, DType::UInt8, 1)?;
        match *field.data {
            [flag] => Ok(flag != 0),
            _ => Err(self.error(name, format!("{} bytes", field.data.len()), "1 byte")),
        }
    }

    /// Which symmetry the measured azimuths leave: one or two of them mean isotropic.
    fn symmetry(&self, phi: &[f32]) -> Result<Symmetry, Error> {
        if phi.len() <= 2 {
            return Ok(Symmetry::Isotropic);
        }
        let span = phi[phi.len() - 1] - phi[0];
        match (TAU / span).round() {
            1.0 => Ok(Symmetry::None),
            2.0 => Ok(Symmetry::HalfTurn),
            4.0 => Ok(Symmetry::Quadrant),
            _ => {
                let found = format!("azimuths over {:.1} degrees", span.to_degrees());
                Err(self.error("phi_i", found, "90, 180 or 360"))
            }
        }
    }
}

fn negative(what: &'static str, values: &[f32]) -> Oddity {
    Oddity::Negative { what, count: values.iter().filter(|&&value| value < 0.0).count() }
}

/// The material's name: the file's, without extension and the database's `_rgb` or `_spec`.
fn material_name(path: &Path) -> String {
    let stem = file::stem(path);
    let name = stem.strip_suffix("_rgb").or_else(|| stem.strip_suffix("_spec"));
    name.unwrap_or(&stem).to_owned()
}
