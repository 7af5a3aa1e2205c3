//! How well a score tells two kinds apart.

/// The probability that one of the wanted kind, drawn by chance, scores higher than one of the other. Ties count half.
///
/// The area under the receiver operating characteristic, which is Mann and Whitney's U divided by all pairs.
/// Nothing comes where there is none of a kind.
///
/// ```
/// use dropj::evaluation::auc;
///
/// assert_eq!(auc(&[(3.0, true), (1.0, true), (2.0, false), (1.0, false)]), Some(0.625));
/// assert_eq!(auc(&[(3.0, true)]), None);
/// ```
pub fn auc(scored: &[(f64, bool)]) -> Option<f64> {
    let mut sorted = scored.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let n_wanted = sorted.iter().filter(|(_, is_wanted)| *is_wanted).count();
    let n_others = sorted.len() - n_wanted;
    // Twice how many others lie below each wanted one. One beside it counts once.
    let (mut twice, mut n_below) = (0, 0);
    for tied in sorted.chunk_by(|a, b| a.0 == b.0) {
        let wanted = tied.iter().filter(|(_, is_wanted)| *is_wanted).count();
        let others = tied.len() - wanted;
        twice += wanted * (2 * n_below + others);
        n_below += others;
    }
    (n_wanted > 0 && n_others > 0).then(|| twice as f64 / (2 * n_wanted * n_others) as f64)
}
