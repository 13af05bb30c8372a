//! Which models no other beats.

/// The indices of the points (cost, error) that no other point is at most equal to in both and below in one, by
/// rising cost.
#[must_use]
pub fn front(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].iter().all(|x| x.is_finite())).collect();
    order.sort_by(|&a, &b| points[a][0].total_cmp(&points[b][0]).then(points[a][1].total_cmp(&points[b][1])));
    let mut least = f64::INFINITY;
    order.retain(|&i| {
        let is_better = points[i][1] < least;
        least = least.min(points[i][1]);
        is_better
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points = [[2.0, 2.0], [1.0, 3.0], [3.0, 1.0], [3.0, 2.5], [1.0, 4.0], [f64::NAN, 0.0]];
        assert_eq!(front(&points), [1, 0, 2]);
        assert!(front(&[]).is_empty());
    }
}
