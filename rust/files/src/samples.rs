//! Scattered measurements: f at any number of pairs of directions, as a goniometer gives them.
//!
//! A `.csv` file holds a sample per line, in the order
//!
//! `light_x, light_y, light_z, view_x, view_y, view_z, r, g, b`
//!
//! or, if a line before the samples names them, in any order; then directions may also be angles in radians,
//! `theta_l, phi_l, theta_v, phi_v, r, g, b`, with θ from the normal, or, as `theta_l_deg` …, in degrees. Numbers
//! are separated by commas, semicolons (with which the decimal mark may be a comma), tabs or spaces. The names may
//! stand behind a `#`, as `numpy.savetxt(header=…)` writes them, and in quotes, as R and spreadsheets do; a column
//! of row names, which is named "" or not at all, is skipped. Empty lines and other remarks behind `#` are skipped.
//! A `.npy` file holds the nine numbers of the first form as (n, 9), of any type of number.
//!
//! Directions point away from the surface, in the local frame with the normal +z; f is in sr⁻¹, linear
//! RGB, without the cosine.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;

use glimt_core::{Oddity, Vec3};
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
    /// Bytes of the file after the samples.
    pub trailing: usize,
}

/// How far the length of a direction may be from 1; what is nearer is normalised.
const LENGTH_TOLERANCE: f64 = 1e-3;
/// Cosines up to this, of either sign, are those of the horizon: 90° as files print it.
const GRAZING_COS: f64 = 1e-4;

/// Columns with Cartesian directions; the order of files without a header, and of arrays.
const CARTESIAN: [&str; 9] = ["light_x", "light_y", "light_z", "view_x", "view_y", "view_z", "r", "g", "b"];
/// Columns with angles.
const ANGLES: [&str; 7] = ["theta_l", "phi_l", "theta_v", "phi_v", "r", "g", "b"];
/// How many of those are angles.
const ANGLE_COUNT: usize = 4;
/// What stands behind the name of an angle in degrees.
const DEGREES: &str = "_deg";
/// Most columns of a line: the longer form and the names of rows.
const MOST_COLUMNS: usize = CARTESIAN.len() + 1;

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
            let (array, trailing) = Array::from_start(bytes)?;
            Samples { trailing, ..Samples::from_array(&array)? }
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

    /// What is odd about the file, and what was made of it.
    #[must_use]
    pub fn oddities(&self) -> Vec<Oddity> {
        let mut oddities = vec![
            Oddity::Negative { what: "f", count: self.clamped },
            Oddity::Grazing { count: self.grazing },
            Oddity::Trailing { bytes: self.trailing },
        ];
        oddities.retain(Oddity::is_there);
        oddities
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
        Samples { light: room(), view: room(), f: room(), ..Samples::default() }
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
        let mut is_headed = false;
        let mut fields = Fields::default();
        for (number, line) in text.lines().enumerate() {
            let at = |reason| format!("line {}: {reason}", number + 1);
            let is_before_samples = samples.is_empty() && samples.grazing == 0;
            if !is_content(line) {
                let remark = line.trim().trim_start_matches('#');
                if is_before_samples && !is_headed && fields.split(remark).names_columns() {
                    columns = Some(Columns::from_header(&fields, remark).map_err(at)?);
                }
            } else if is_before_samples && !is_headed && fields.split(line).is_header() {
                columns = Some(Columns::from_header(&fields, line).map_err(at)?);
                is_headed = true;
            } else {
                let columns = columns.get_or_insert_with(Columns::standard);
                let row = columns.row(fields.split(line)).map_err(at)?;
                samples.push(row).map_err(at)?;
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

/// Whether a line holds more than a remark.
fn is_content(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

/// What separates the fields of a line; `None` for spaces, any number of them. See the module.
fn separator(line: &str) -> Option<u8> {
    let has = |mark: char| line.contains(mark);
    if has(';') {
        Some(b';')
    } else if has('\t') && !line.contains(",\t") {
        Some(b'\t')
    } else {
        has(',').then_some(b',')
    }
}

/// The fields of a line without the quotes around them, of which no more are kept than any line has that is read.
#[derive(Default)]
struct Fields {
    /// One behind the other.
    text: String,
    ends: [usize; MOST_COLUMNS + 1],
    count: usize,
    /// Whether there is a quote before the first: R writes the names of rows so.
    is_quoted: bool,
    parser: Option<(u8, csv_core::Reader)>,
}

impl Fields {
    /// Reads a line. One with a separator is CSV (RFC 4180).
    fn split(&mut self, line: &str) -> &Self {
        let line = line.trim();
        self.count = 0;
        self.is_quoted = line.starts_with('"');
        let mut bytes = std::mem::take(&mut self.text).into_bytes();
        bytes.clear();
        match separator(line) {
            Some(separator) => self.parse(line.as_bytes(), separator, &mut bytes),
            None => {
                for field in line.split_whitespace() {
                    bytes.extend_from_slice(field.as_bytes());
                    self.end_at(&[bytes.len()]);
                }
            }
        }
        self.text = String::from_utf8(bytes).expect("fields of a text are text");
        self
    }

    fn parse(&mut self, mut line: &[u8], separator: u8, out: &mut Vec<u8>) {
        let build = || csv_core::ReaderBuilder::new().delimiter(separator).build();
        let mut parser = match self.parser.take() {
            Some((last, parser)) if last == separator => parser,
            _ => build(),
        };
        parser.reset();
        // No field is longer than it is written.
        out.resize(line.len(), 0);
        let mut written = 0;
        loop {
            let mut ends = [0; MOST_COLUMNS + 1];
            let (result, read, more, ended) = parser.read_record(line, &mut out[written..], &mut ends);
            line = &line[read..];
            written += more;
            self.end_at(&ends[..ended]);
            // An empty rest ends the record.
            if matches!(result, csv_core::ReadRecordResult::Record | csv_core::ReadRecordResult::End) {
                break;
            }
        }
        out.truncate(written);
        self.parser = Some((separator, parser));
    }

    fn end_at(&mut self, ends: &[usize]) {
        for &end in ends {
            if let Some(place) = self.ends.get_mut(self.count) {
                *place = end;
            }
            self.count += 1;
        }
    }

    fn iter(&self) -> impl Iterator<Item = &str> {
        let ends = &self.ends[..self.count.min(self.ends.len())];
        let starts = std::iter::once(&0).chain(ends);
        starts.zip(ends).map(|(&start, &end)| unquoted(self.text[start..end].trim()))
    }

    fn is_header(&self) -> bool {
        self.iter().next().is_some_and(|first| number(first).is_none())
    }

    /// Whether a remark names columns: most of its words are names that are known.
    fn names_columns(&self) -> bool {
        let (mut known, mut all) = (0, 0);
        for field in self.iter().take(MOST_COLUMNS) {
            known += usize::from(is_known(&column_name(field)));
            all += 1;
        }
        known >= 2 && 2 * known > all
    }
}

/// A field without the quotes that CSV does not know as such: single ones, and those behind a space.
fn unquoted(field: &str) -> &str {
    let within = |quote: char| field.strip_prefix(quote)?.strip_suffix(quote);
    within('"').or_else(|| within('\'')).map_or(field, str::trim)
}

/// A number, whose decimal mark may be a comma.
fn number(field: &str) -> Option<f64> {
    field.parse().ok().or_else(|| field.replacen(',', ".", 1).parse().ok())
}

/// The name of a column as it is known here, however it is spelled: R has dots where others have spaces.
fn column_name(field: &str) -> String {
    field.to_lowercase().replace([' ', '.', '-'], "_")
}

fn is_known(name: &str) -> bool {
    let angle = name.strip_suffix(DEGREES).is_some_and(|name| ANGLES[..ANGLE_COUNT].contains(&name));
    angle || CARTESIAN.contains(&name) || ANGLES.contains(&name)
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

    /// `units` are radians per unit of the four angles.
    fn angles(numbers: &[f64; 7], units: &[f64; ANGLE_COUNT]) -> Result<Row, String> {
        let mut angles = [0.0; ANGLE_COUNT];
        for (i, angle) in angles.iter_mut().enumerate() {
            *angle = numbers[i] * units[i];
            // θ of every other column, and φ.
            let (most, words) = if i % 2 == 0 { (FRAC_PI_2, "π/2 (90°)") } else { (TAU, "2π (360°)") };
            if angle.abs() > most + GRAZING_COS {
                return Err(out_of_range(ANGLES[i], numbers[i], units[i], words));
            }
        }
        let [theta_l, phi_l, theta_v, phi_v] = angles;
        let direction =
            |theta: f64, phi: f64| [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
        let [.., r, g, b] = *numbers;
        Ok(Row { light: direction(theta_l, phi_l), view: direction(theta_v, phi_v), f: [r, g, b] })
    }
}

fn out_of_range(name: &str, found: f64, unit: f64, most: &str) -> String {
    if unit == 1.0 {
        format!(
            "{name} is {found}, expected radians of at most {most}; if angles are in degrees, name the columns \
             {name}{DEGREES} …"
        )
    } else {
        format!("{name}{DEGREES} is {found}, expected degrees of at most {most}")
    }
}

/// What the columns of a file are.
enum Columns {
    Cartesian(Places<9>),
    /// The units are radians per unit of the four angles.
    Angles(Places<7>, [f64; ANGLE_COUNT]),
}

/// For each of a form's names, the column where it stands, among so many columns.
struct Places<const N: usize> {
    columns: [usize; N],
    width: usize,
}

impl Columns {
    fn standard() -> Columns {
        Columns::Cartesian(Places { columns: std::array::from_fn(|i| i), width: CARTESIAN.len() })
    }

    fn from_header(fields: &Fields, line: &str) -> Result<Columns, String> {
        // One more than any form has tells that there are too many, however long the line is.
        let names: Vec<String> = fields.iter().map(column_name).collect();
        let plain = |name: &str| names.iter().position(|other| other == name).map(|place| (place, 1.0));
        let degrees = |name: &str| Some((plain(&format!("{name}{DEGREES}"))?.0, 1_f64.to_radians()));
        if let Some((places, _)) = Places::find(&CARTESIAN, &names, plain) {
            Ok(Columns::Cartesian(places))
        } else if let Some((places, units)) =
            Places::find(&ANGLES, &names, |name| plain(name).or_else(|| degrees(name)))
        {
            Ok(Columns::Angles(places, std::array::from_fn(|i| units[i])))
        } else {
            let unknown = names.iter().find(|name| !name.is_empty() && !is_known(name));
            let unknown = unknown.map(|name| format!(", of which \"{}\" is unknown", excerpt(name)));
            Err(format!(
                "the columns are \"{}\"{}; expected {} or {} (radians; degrees as theta_l{DEGREES} …), in any order",
                excerpt(line.trim()),
                unknown.unwrap_or_default(),
                CARTESIAN.join(","),
                ANGLES.join(",")
            ))
        }
    }

    fn row(&self, fields: &Fields) -> Result<Row, String> {
        match self {
            Columns::Cartesian(places) => Ok(Row::cartesian(&places.numbers(fields)?)),
            Columns::Angles(places, units) => Row::angles(&places.numbers(fields)?, units),
        }
    }
}

impl<const N: usize> Places<N> {
    /// Where `place` finds each of `wanted`, with its units, if there are no other columns but one without a name.
    fn find(
        wanted: &[&str; N],
        names: &[String],
        place: impl Fn(&str) -> Option<(usize, f64)>,
    ) -> Option<(Places<N>, [f64; N])> {
        let (mut columns, mut units) = ([0; N], [1.0; N]);
        for (i, wanted) in wanted.iter().enumerate() {
            (columns[i], units[i]) = place(wanted)?;
        }
        let unnamed = names.iter().filter(|name| name.is_empty()).count();
        let is_whole = unnamed <= 1 && names.len() == N + unnamed;
        is_whole.then_some((Places { columns, width: names.len() }, units))
    }

    /// The numbers of a line in the order of the form.
    fn numbers(&self, fields: &Fields) -> Result<[f64; N], String> {
        let mut read = [""; MOST_COLUMNS];
        read.iter_mut().zip(fields.iter()).for_each(|(place, field)| *place = field);
        // R has no name for their column.
        let row_names = usize::from(fields.count == self.width + 1 && fields.is_quoted);
        if fields.count != self.width + row_names {
            return Err(format!("{} columns, expected {}", fields.count, self.width));
        }
        let mut numbers = [0.0; N];
        for (found, column) in numbers.iter_mut().zip(self.columns) {
            let column = column + row_names;
            *found = number(read[column]).ok_or_else(|| {
                format!("\"{}\" is not a number (column {})", excerpt(read[column]), column + 1)
            })?;
        }
        Ok(numbers)
    }
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
    fn angles_in_degrees_are_read_where_they_are_named_so_and_else_refused() {
        let degrees = "theta_l_deg,phi_l_deg,theta_v,phi_v_deg,r,g,b\n30,-90,0.5235987755982988,180,1,2,3";
        let radians = "theta_l,phi_l,theta_v,phi_v,r,g,b\n\
                       0.5235987755982988,-1.5707963267948966,0.5235987755982988,3.141592653589793,1,2,3";
        let (degrees, radians) = (read(degrees).unwrap(), read(radians).unwrap());
        assert!((degrees.light[0] - radians.light[0]).length() < 1e-6, "{}", degrees.light[0]);
        assert!((degrees.view[0] - radians.view[0]).length() < 1e-6, "{}", degrees.view[0]);
        for (row, expected) in [
            (
                "30,0,0.1,0,1,1,1",
                "theta_l is 30, expected radians of at most π/2 (90°); if angles are in degrees",
            ),
            ("0.1,0,-1.6,0,1,1,1", "theta_v is -1.6, expected radians"),
            ("1,180,1,0,1,1,1", "phi_l is 180, expected radians of at most 2π"),
        ] {
            let message = read(&format!("theta_l,phi_l,theta_v,phi_v,r,g,b\n{row}")).unwrap_err();
            assert!(message.contains(expected) && message.contains("_deg"), "{message}");
        }
        let message = read("theta_l_deg,phi_l_deg,theta_v_deg,phi_v_deg,r,g,b\n95,0,0,0,1,1,1").unwrap_err();
        assert!(message.contains("theta_l_deg is 95, expected degrees"), "{message}");
        // 90° as files print it is the horizon.
        assert_eq!(read(&format!("{ANGLE_NAMES}\n1.5708,0,0,0,1,1,1\n0,0,0,0,1,1,1")).unwrap().grazing, 1);
    }

    const ANGLE_NAMES: &str = "theta_l,phi_l,theta_v,phi_v,r,g,b";

    #[test]
    fn headers_and_separators_of_every_program_are_read() {
        let expected = Samples {
            light: vec![Vec3::Z, Vec3::new(0.6, 0.0, 0.8)],
            view: vec![Vec3::new(0.6, 0.0, 0.8), Vec3::Z],
            f: vec![Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.5)],
            ..Samples::default()
        };
        for (program, text) in [
            (
                "numpy.savetxt(header=…, delimiter=\",\")",
                "# b,g,r,view_x,view_y,view_z,light_x,light_y,light_z\n3,2,1,.6,0,.8,0,0,1\n6.5,5,4,0,0,1,.6,0,.8\n",
            ),
            (
                "numpy.savetxt(header=…)",
                "# b g r view_x view_y view_z light_x light_y light_z\n\
                 3.0e+00 2.0e+00 1.0e+00 6.0e-01 0 8.0e-01 0 0 1\n6.5 5 4 0 0 1 0.6 0 0.8\n",
            ),
            (
                "a remark before the names, and names with commas over numbers with spaces",
                "# cloth, scan 7\n#b,g,r,view_x,view_y,view_z,light_x,light_y,light_z\n\
                 3 2 1 .6 0 .8 0 0 1\n6.5  5 4  0 0 1 .6 0 .8",
            ),
            (
                "R write.csv",
                "\"\",\"light.x\",\"light.y\",\"light.z\",\"view.x\",\"view.y\",\"view.z\",\"r\",\"g\",\"b\"\n\
                 \"1\",0,0,1,0.6,0,0.8,1,2,3\n\"b\",0.6,0,0.8,0,0,1,4,5,6.5\n",
            ),
            (
                "R write.table",
                "\"light_x\" \"light_y\" \"light_z\" \"view_x\" \"view_y\" \"view_z\" \"r\" \"g\" \"b\"\n\
                 \"1\" 0 0 1 0.6 0 0.8 1 2 3\n\"2\" 0.6 0 0.8 0 0 1 4 5 6.5\n",
            ),
            (
                "R write.csv2, spreadsheets where the decimal mark is a comma",
                "\"Light X\";\"Light Y\";\"Light Z\";view_x;view_y;view_z;R;G;B\r\n\
                 0;0;1;0,6;0;0,8;1;2;3\r\n0,6;0;0,8;0;0;1;4;5;6,5\r\n",
            ),
            (
                "quotes around whole lines of names and numbers, and a remark in a quoted name of a row",
                "\"\",'light_x','light_y', \"light_z\",view_x,view_y,view_z,r,g,b\n\
                 \"one, \"\"two\"\"\",\"0\",0,1,0.6,0,0.8,1,2,3\n\"x\",0.6,0,0.8,0,0,1,4,5,6.5\n",
            ),
            (
                "pandas",
                ",light_x,light_y,light_z,view_x,view_y,view_z,r,g,b\n\
                 0,0,0,1,0.6,0,0.8,1,2,3\n1,0.6,0,0.8,0,0,1,4,5,6.5\n",
            ),
            (
                "tabs",
                "light_x\tlight_y\tlight_z\tview_x\tview_y\tview_z\tr\tg\tb\n\
                 0\t0\t1\t.6\t0\t.8\t1\t2\t3\n.6\t0\t.8\t0\t0\t1\t4\t5\t6.5\n",
            ),
        ] {
            assert_eq!(read(text).as_ref(), Ok(&expected), "{program}");
        }
    }

    #[test]
    fn names_behind_a_mark_that_are_unknown_are_refused_and_remarks_are_not() {
        let row = "0,0,1,0,0,1,1,2,3\n";
        let message = read(&format!("# light_x,light_y,light_z,eye_x,eye_y,eye_z,r,g,b\n{row}")).unwrap_err();
        assert!(message.contains("line 1") && message.contains("\"eye_x\" is unknown"), "{message}");
        assert!(message.contains("expected light_x,light_y,light_z,view_x"), "{message}");
        for remark in ["# a scan, of felt", "# r is red, g is green", "#", "# b"] {
            assert_eq!(read(&format!("{remark}\n{row}")).unwrap().f, [Vec3::new(1.0, 2.0, 3.0)], "{remark}");
        }
        // Names after the first sample come too late.
        let late = read(&format!("{row}light_x,light_y,light_z,view_x,view_y,view_z,b,g,r\n{row}"));
        assert!(late.unwrap_err().contains("line 2: \"light_x\" is not a number"));
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
            ("0,0,1,0,0,1,1,1,1,,,,,,,,,,,,,,,,,", "line 3: 26 columns, expected 9"),
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
        assert!(
            read("x,y,z\n")
                .unwrap_err()
                .contains("the columns are \"x,y,z\", of which \"x\" is unknown; expected light_x")
        );
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
