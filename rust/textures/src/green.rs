//! Which way the green channel of a normal map points, by heights of the same surface.

/// The longest side of heights and normals that are compared.
pub(crate) const COMPARED: usize = 256;

/// Whether y points up in the image in these slopes of normals, which are −∂h/∂x and −∂h/∂y of the heights h. What is
/// painted as heights may be depths: that shows along x.
pub(crate) fn points_up(size: [usize; 2], heights: &[[f32; 1]], slopes: &[[f32; 2]]) -> Option<bool> {
    let [width, height] = size;
    let at = |x: usize, y: usize| f64::from(heights[y % height * width + x % width][0]);
    let (mut across, mut along) = (Correlation::default(), Correlation::default());
    for y in 0..height {
        for x in 0..width {
            let [right, up] = slopes[y * width + x].map(f64::from);
            across.add(right, at(x + width - 1, y) - at(x + 1, y));
            // Rows go down.
            along.add(up, at(x, y + 1) - at(x, y + height - 1));
        }
    }
    let sign = if across.value() < -CLEAR { -1.0 } else { 1.0 };
    let agreement = sign * along.value();
    (agreement.abs() > CLEAR).then_some(agreement > 0.0)
}

/// A correlation that says something.
const CLEAR: f64 = 0.3;

/// The correlation of numbers whose means are 0, as those of slopes of a closed tile are.
#[derive(Default)]
struct Correlation {
    squares: [f64; 2],
    products: f64,
}

impl Correlation {
    fn add(&mut self, a: f64, b: f64) {
        if a.is_finite() && b.is_finite() {
            self.squares[0] += a * a;
            self.squares[1] += b * b;
            self.products += a * b;
        }
    }

    /// 0 where there is nothing to compare.
    fn value(&self) -> f64 {
        let scale = (self.squares[0] * self.squares[1]).sqrt();
        if scale > 0.0 { self.products / scale } else { 0.0 }
    }
}
