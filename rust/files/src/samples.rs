//! Scattered measurements: f at any number of pairs of directions, as a goniometer gives them.
//!
//! A `.csv` file holds a sample per line, separated by commas, in the order
//!
//! `light_x, light_y, light_z, view_x, view_y, view_z, r, g, b`
//!
//! or, if its first line names them, in any order; then directions may also be angles in radians,
//! `theta_l, phi_l, theta_v, phi_v, r, g, b`, with θ from the normal. Empty lines and those that begin
//! with `#` are skipped. A `.npy` file holds the nine numbers of the first form as (n, 9) float32 or float64.
//!
//! Directions point away from the surface, in the local frame with the normal +z; f is in sr⁻¹, linear
//! RGB, without the cosine.

use std::path::Path;

use glimt_core::Vec3;
use glimt_measured::file::read_regular;

use crate::error::{Error, excerpt};
use crate::npy::{self, Array};

/// Scattered measurements of one material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Unit directions to the light.
    pub light: Vec<Vec3>,
    /// Unit directions to the viewer.
    pub view: Vec<Vec3>,
    /// f_r in sr⁻¹, linear RGB, finite and ≥ 0.
    pub f: Vec<Vec3>,
    /// Number of negative values in the file, which are taken as 0.
    pub clamped: usize,
    /// Number of samples in the file with a direction at the horizon, which carry no light and are left out.
    pub grazing: usize,
}

/// How far the length of a direction may be from 1; what is nearer is normalised.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// Cosines up to this, of either sign, are those of the horizon: 90° as files print it.
const GRAZING_COS: f64 = 1e-4;

/// Columns with Cartesian directions; the order of files without a header, and of arrays.
const CARTESIAN: [&str; 9] = ["light_x", "light_y", "light_z", "view_x", "view_y", "view_z", "r", "g", "b"];
/// Columns with angles.
const ANGLES: [&str; 7] = ["theta_l", "phi_l", "theta_v", "phi_v", "r", "g", "b"];

impl Samples {
    /// Reads a `.csv` or `.npy` file, told apart by their content.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`], which names the line: another number of columns, what is no
    /// finite number, a direction below the horizon or not of unit length; or no sample at all.
    pub fn open(path: impl AsRef<Path>) -> Result<Samples, Error> {
        let path = path.as_ref();
        let bytes = read_regular(path).map_err(Error::read(path))?;
        let format = if is_array(&bytes) {
            "an array (n, 9) of scattered samples (.npy)"
        } else {
            "a list of scattered samples (.csv)"
        };
        Samples::from_bytes(&bytes).map_err(|reason| Error::Format { path: path.to_owned(), format, reason })
    }

    /// Decodes the bytes of a `.csv` or `.npy` file.
    ///
    /// # Errors
    /// In words, the line, what was found and what was expected.
    pub fn from_bytes(bytes: &[u8]) -> Result<Samples, String> {
        let samples = if is_array(bytes) {
            Samples::from_array(&Array::from_bytes(bytes)?)?
        } else {
            Samples::from_csv(std::str::from_utf8(bytes).map_err(|_| "it is not text")?)?
        };
        if samples.is_empty() {
            return Err(match samples.grazing {
                0 => "it holds no sample".to_owned(),
                n => format!("all of its {n} samples have a direction at the horizon"),
            });
        }
        Ok(samples)
    }

    /// Takes the samples out for which `is_taken` says so, which has an item for each.
    #[must_use]
    pub fn take(&mut self, is_taken: &[bool]) -> Samples {
        fn split(values: &mut Vec<Vec3>, is_taken: &[bool]) -> Vec<Vec3> {
            let of =
                |wanted| values.iter().zip(is_taken).filter(move |&(_, &t)| t == wanted).map(|(&v, _)| v);
            let (left, taken) = (of(false).collect(), of(true).collect());
            *values = left;
            taken
        }
        Samples {
            light: split(&mut self.light, is_taken),
            view: split(&mut self.view, is_taken),
            f: split(&mut self.f, is_taken),
            ..Samples::default()
        }
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.f.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.f.is_empty()
    }

    fn with_capacity(samples: usize) -> Samples {
        let room = || Vec::with_capacity(samples);
        Samples { light: room(), view: room(), f: room(), clamped: 0, grazing: 0 }
    }

    fn from_array(array: &Array) -> Result<Samples, String> {
        let [rows, 9] = array.shape[..] else {
            return Err(format!(
                "its shape is {:?}, expected (n, 9): light x y z, view x y z, r g b",
                array.shape
            ));
        };
        let mut samples = Samples::with_capacity(rows);
        for (row, values) in array.values.chunks_exact(9).enumerate() {
            let numbers = std::array::from_fn(|i| f64::from(values[i]));
            samples.push(Row::cartesian(&numbers)).map_err(|reason| format!("row {row}: {reason}"))?;
        }
        Ok(samples)
    }

    fn from_csv(text: &str) -> Result<Samples, String> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut samples = Samples::with_capacity(text.lines().filter(|line| is_content(line)).count());
        let mut columns = None;
        for (number, line) in text.lines().enumerate().filter(|(_, line)| is_content(line)) {
            let at = |reason| format!("line {}: {reason}", number + 1);
            match &columns {
                None if is_header(line) => columns = Some(Columns::from_header(line).map_err(at)?),
                _ => {
                    let columns = columns.get_or_insert_with(Columns::standard);
                    let row = columns.row(line).map_err(at)?;
                    samples.push(row).map_err(at)?;
                }
            }
        }
        Ok(samples)
    }

    fn push(&mut self, row: Row) -> Result<(), String> {
        let (light, view) = (direction("light", row.light)?, direction("view", row.view)?);
        let mut f = Vec3::ZERO;
        let mut negative = 0;
        for (value, number) in f.as_mut().iter_mut().zip(row.f) {
            let number = number as f32;
            if !number.is_finite() {
                return Err(format!("f is {:?}, expected finite numbers", row.f));
            }
            negative += usize::from(number < 0.0);
            *value = number.max(0.0);
        }
        self.clamped += negative;
        let (Some(light), Some(view)) = (light, view) else {
            self.grazing += 1;
            return Ok(());
        };
        self.light.push(light);
        self.view.push(view);
        self.f.push(f);
        Ok(())
    }
}

fn is_array(bytes: &[u8]) -> bool {
    bytes.starts_with(npy::MAGIC)
}

/// Whether a line holds a sample or the names of columns.
fn is_content(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

fn is_header(line: &str) -> bool {
    fields(line).next().is_some_and(|first| first.parse::<f64>().is_err())
}

fn fields(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(str::trim)
}

/// The numbers of a sample before they are checked.
struct Row {
    light: [f64; 3],
    view: [f64; 3],
    f: [f64; 3],
}

impl Row {
    fn cartesian(&[lx, ly, lz, vx, vy, vz, r, g, b]: &[f64; 9]) -> Row {
        Row { light: [lx, ly, lz], view: [vx, vy, vz], f: [r, g, b] }
    }

    fn angles(&[theta_l, phi_l, theta_v, phi_v, r, g, b]: &[f64; 7]) -> Row {
        let direction =
            |theta: f64, phi: f64| [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
        Row { light: direction(theta_l, phi_l), view: direction(theta_v, phi_v), f: [r, g, b] }
    }
}

/// What the columns of a file are: for each of a form's names, the column where it stands.
enum Columns {
    Cartesian([usize; 9]),
    Angles([usize; 7]),
}

impl Columns {
    fn standard() -> Columns {
        Columns::Cartesian(std::array::from_fn(|i| i))
    }

    fn from_header(line: &str) -> Result<Columns, String> {
        // One more than any form has tells that there are too many, however long the line is.
        let names: Vec<String> = fields(line).take(CARTESIAN.len() + 1).map(str::to_lowercase).collect();
        if let Some(columns) = places(&CARTESIAN, &names) {
            Ok(Columns::Cartesian(columns))
        } else if let Some(columns) = places(&ANGLES, &names) {
            Ok(Columns::Angles(columns))
        } else {
            Err(format!(
                "the columns are \"{}\", expected {} or {} (radians), in any order",
                excerpt(line.trim()),
                CARTESIAN.join(","),
                ANGLES.join(",")
            ))
        }
    }

    fn row(&self, line: &str) -> Result<Row, String> {
        match self {
            Columns::Cartesian(columns) => Ok(Row::cartesian(&numbers(line, columns)?)),
            Columns::Angles(columns) => Ok(Row::angles(&numbers(line, columns)?)),
        }
    }
}

/// Where each of `wanted` stands in `names`, if these are the same names.
fn places<const N: usize>(wanted: &[&str; N], names: &[String]) -> Option<[usize; N]> {
    let mut columns = [0; N];
    for (column, wanted) in columns.iter_mut().zip(wanted) {
        *column = names.iter().position(|name| name == wanted)?;
    }
    (names.len() == N).then_some(columns)
}

/// The numbers of a line, taken from these columns.
fn numbers<const N: usize>(line: &str, columns: &[usize; N]) -> Result<[f64; N], String> {
    let mut read = [0.0; N];
    let mut count = 0;
    for field in fields(line) {
        if let Some(number) = read.get_mut(count) {
            *number = field
                .parse()
                .map_err(|_| format!("\"{}\" is not a number (column {})", excerpt(field), count + 1))?;
        }
        count += 1;
    }
    if count != N {
        return Err(format!("{count} columns, expected {N}"));
    }
    Ok(columns.map(|column| read[column]))
}

/// A unit direction; `None` at the horizon.
fn direction(name: &str, [x, y, z]: [f64; 3]) -> Result<Option<Vec3>, String> {
    let length = (x * x + y * y + z * z).sqrt();
    if length.is_nan() || (length - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(format!("the {name} direction has the length {length}, expected 1"));
    }
    let cos = z / length;
    if cos < -GRAZING_COS {
        return Err(format!("the {name} direction is below the horizon (z = {z}); the normal is +z"));
    }
    let unit = Vec3::new((x / length) as f32, (y / length) as f32, cos as f32);
    Ok((cos > GRAZING_COS).then_some(unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Samples, String> {
        Samples::from_bytes(text.as_bytes())
    }

    #[test]
    fn a_header_is_optional_and_may_reorder() {
        let plain = read("0,0,1, 0.6,0,0.8, 1,2,3\n\n# a remark\n0.6,0,0.8, 0,0,1, 4,5,6\n").unwrap();
        assert_eq!(plain.light, [Vec3::Z, Vec3::new(0.6, 0.0, 0.8)]);
        assert_eq!(plain.view, [Vec3::new(0.6, 0.0, 0.8), Vec3::Z]);
        assert_eq!(plain.f, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)]);
        let named = "\u{feff}B,g,r,view_x,view_y,view_z,light_x,light_y,light_z\r\n\
                     3,2,1,.6,0,.8,0,0,1\r\n6,5,4,0,0,1,.6,0,.8\r\n";
        assert_eq!(read(named).unwrap(), plain);
    }

    #[test]
    fn angles_are_radians_from_the_normal() {
        let theta = 0.8f64.acos();
        let text = format!("theta_l,phi_l,theta_v,phi_v,r,g,b\n{theta},0,{theta},1.5707963267948966,1,2,3");
        let samples = read(&text).unwrap();
        assert!((samples.light[0] - Vec3::new(0.6, 0.0, 0.8)).length() < 1e-6, "{}", samples.light[0]);
        assert!((samples.view[0] - Vec3::new(0.0, 0.6, 0.8)).length() < 1e-6, "{}", samples.view[0]);
        assert_eq!(samples.f[0], Vec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn arrays_hold_the_same_as_text() {
        let values = [0.6, 0.0, 0.8, 0.0, 0.0, 1.0, 0.25, -1.0, 4.0];
        let array = Array { shape: vec![1, 9], values: values.to_vec() };
        let samples = Samples::from_bytes(&array.to_bytes()).unwrap();
        assert_eq!(samples, read("0.6,0,0.8,0,0,1,0.25,-1,4").unwrap());
        assert_eq!(samples.f, [Vec3::new(0.25, 0.0, 4.0)]);
        assert_eq!(samples.clamped, 1);
        let pairs = Array { shape: vec![1, 6], values: values[..6].to_vec() };
        let message = Samples::from_bytes(&pairs.to_bytes()).unwrap_err();
        assert!(message.contains("its shape is [1, 6], expected (n, 9)"), "{message}");
    }

    #[test]
    fn samples_that_are_taken_out_leave_the_others() {
        let csv = "0,0,1,0,0,1,1,1,1\n0,0,1,0,0,1,2,2,2\n0,0,1,0,0,1,3,3,3\n";
        let mut samples = Samples::from_bytes(csv.as_bytes()).unwrap();
        let taken = samples.take(&[false, true, false]);
        assert_eq!((taken.f, taken.light.len()), (vec![Vec3::splat(2.0)], 1));
        assert_eq!((samples.f, samples.view.len()), (vec![Vec3::ONE, Vec3::splat(3.0)], 2));
    }

    #[test]
    fn lengths_are_normalised_within_the_tolerance() {
        let samples = read("0,0,1.0005, 0.6,0,0.8, 1,1,1").unwrap();
        assert_eq!(samples.light[0], Vec3::Z);
    }

    #[test]
    fn grazing_samples_are_left_out_and_counted() {
        let samples = read("0,0,1,1,0,0,1,1,1\n1,0,-1e-8,0,0,1,1,1,1\n0,0,1,0,0,1,1,1,1").unwrap();
        assert_eq!((samples.len(), samples.grazing), (1, 2));
        assert!(read("0,0,1,1,0,0,1,1,1").unwrap_err().contains("all of its 1 samples"));
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_line() {
        let good = "0,0,1,0,0,1,1,1,1\n";
        for (line, expected) in [
            ("0,0,1,0,0,1,1,1", "line 3: 8 columns, expected 9"),
            ("0,0,1,0,0,1,1,1,1,1", "line 3: 10 columns, expected 9"),
            ("0,0,1,0,0,x,1,1,1", "line 3: \"x\" is not a number (column 6)"),
            ("0,0,2,0,0,1,1,1,1", "line 3: the light direction has the length 2, expected 1"),
            ("0,0,1,NaN,0,1,1,1,1", "line 3: the view direction has the length NaN"),
            ("0,0,1,0,0.6,-0.8,1,1,1", "line 3: the view direction is below the horizon (z = -0.8)"),
            ("0,0,1,0,0,1,1,inf,1", "line 3: f is [1.0, inf, 1.0], expected finite"),
            ("0,0,1,0,0,1,1,1e39,1", "line 3: f is [1.0, 1e39, 1.0], expected finite"),
        ] {
            let message = read(&format!("# scan\n{good}{line}\n")).unwrap_err();
            assert!(message.contains(expected), "{message}");
        }
        assert!(read("x,y,z\n").unwrap_err().contains("line 1: the columns are \"x,y,z\", expected light_x"));
        assert!(read("theta_l,phi_l,theta_v,phi_v,r,g,g\n").unwrap_err().contains("line 1: the columns"));
        let long = read(&",".repeat(10_000)).unwrap_err();
        assert!(long.contains("…") && long.len() < 400, "{long}");
        assert!(read("").unwrap_err().contains("no sample"));
        assert!(Samples::from_bytes(b"\xff\xfe0").unwrap_err().contains("not text"));
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloth.csv");
        std::fs::write(&path, "0,0,1").unwrap();
        let message = Samples::open(&path).unwrap_err().to_string();
        assert!(message.contains("cloth.csv is not a list of scattered samples"), "{message}");
        assert!(message.contains("line 1: 3 columns"), "{message}");
        assert!(matches!(Samples::open(folder.path()), Err(Error::Read { .. })));
    }
}
