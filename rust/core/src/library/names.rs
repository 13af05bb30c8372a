//! Near misses of names, for messages.

/// Names that resemble `name`, best first: those that contain it or are contained in it, and those
/// within a few edits.
#[must_use]
pub fn nearest<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Vec<String> {
    const MOST: usize = 3;
    let wanted = name.to_lowercase();
    let mut scored: Vec<(usize, &str)> = names
        .filter_map(|candidate| {
            let lower = candidate.to_lowercase();
            let contains = !wanted.is_empty() && (lower.contains(&wanted) || wanted.contains(&lower));
            let distance = if contains { 0 } else { strsim::levenshtein(&wanted, &lower) };
            (contains || distance <= wanted.len().max(lower.len()) / 3).then_some((distance, candidate))
        })
        .collect();
    scored.sort();
    scored.into_iter().take(MOST).map(|(_, name)| name.to_owned()).collect()
}
