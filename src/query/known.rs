//! What clips are likely to show, by what was said of others near them: so that queries are about what was asked least, and
//! few show two that are unsafe.

use std::collections::BTreeMap;

use rand::seq::IteratorRandom as _;
use rand::{Rng, RngExt as _};

use crate::query::strategy::sample_pair;
use crate::query::{
    Active, DreamId, Justification, Justifications, Preference, Response, SEGMENT_LEN, SafetyAnswer,
    SegmentRef,
};

/// What was said of a clip goes for those that begin at most so many steps before or after it.
const REACH: usize = 2 * SEGMENT_LEN;
/// A clip that is asked about for what another one shows begins at most so many steps before or after that.
const NEAR: usize = SEGMENT_LEN / 2;
/// So often another pair is drawn where one is not wanted.
const N_TRIES: usize = 50;
/// The justification that stands for all that is unsafe where only that is asked.
const UNSAFE: Justification = Justification(0);

/// What a clip was said to show: these, or nothing unsafe.
type Shown = Option<Active>;

/// What clips were said to show, and how often each justification decided.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownClips {
    /// The justification that says nothing.
    default: Justification,
    /// By where they begin.
    clips: BTreeMap<DreamId, BTreeMap<usize, Shown>>,
    /// Answers that name each.
    n_named: BTreeMap<Justification, usize>,
}

impl KnownClips {
    /// Nothing yet, where answers name these.
    pub fn new(justifications: &Justifications) -> Self {
        Self { default: justifications.default(), clips: BTreeMap::new(), n_named: BTreeMap::new() }
    }

    /// Records what was answered about a pair. Some answers say nothing of safety.
    pub fn record(&mut self, pair: [SegmentRef; 2], response: Response) {
        let Some(shown) = self.shown_by(response) else { return };
        *self.n_named.entry(named(shown, self.default)).or_default() += 1;
        for (segment, shown) in pair.into_iter().zip(shown) {
            self.clips.entry(segment.dream).or_default().insert(segment.start, shown);
        }
    }

    /// What each clip shows, going by an answer: what decides is shown by the one that is not preferred, or by both.
    fn shown_by(&self, response: Response) -> Option<[Shown; 2]> {
        let bad = Some(Active::of(UNSAFE));
        Some(match response {
            Response::Safety(SafetyAnswer::OnlyLeft) => [None, bad],
            Response::Safety(SafetyAnswer::OnlyRight) => [bad, None],
            Response::Safety(SafetyAnswer::Neither) => [bad, bad],
            Response::Safety(SafetyAnswer::Both(_)) => [None, None],
            Response::Justified(active, _) if active.most_severe() == self.default => [None, None],
            Response::Justified(active, Preference::Left) => [None, Some(active)],
            Response::Justified(active, Preference::Right) => [Some(active), None],
            Response::Justified(active, Preference::Equal) => [Some(active); 2],
            Response::Preferred(_) | Response::Skipped(_) | Response::Judged(_) => return None,
        })
    }

    /// What a clip is likely to show: what was said of the nearest that is near. Nothing comes where none is.
    fn guess(&self, segment: SegmentRef) -> Option<Shown> {
        let clips = self.clips.get(&segment.dream)?;
        let near = clips.range(segment.start.saturating_sub(REACH)..=segment.start + REACH);
        near.min_by_key(|(start, _)| start.abs_diff(segment.start)).map(|(_, shown)| *shown)
    }

    /// Whether a clip is likely to stay safe.
    pub fn is_safe(&self, segment: SegmentRef) -> Option<bool> {
        self.guess(segment).map(|shown| shown.is_none())
    }

    /// How likely a pair is kept that was drawn by chance.
    ///
    /// From two unsafe clips nothing is learned but that they are alike, and of safety more is soon known than of taste.
    fn share_kept(&self, pair: [SegmentRef; 2]) -> f64 {
        // Where nothing is known of a clip, it may be either.
        let chance = |segment| self.is_safe(segment).map_or(0.5, |is_safe| if is_safe { 1.0 } else { 0.0 });
        let [left, right] = pair.map(chance);
        0.5 * (left + right)
    }

    /// The justification that was named least of those that have been shown, the default among them. At a tie the most severe.
    fn least_named(&self) -> Justification {
        let shown = self.clips.values().flat_map(BTreeMap::values).flatten().flat_map(|active| active.iter());
        let all = shown.chain([self.default]);
        let n_of = |it: &Justification| (self.n_named.get(it).copied().unwrap_or(0), *it);
        all.min_by_key(n_of).unwrap_or(self.default)
    }

    /// Whether an answer about this pair likely names `wanted`, by what is known of it.
    ///
    /// Where nothing is known of a clip, it may show anything.
    fn is_likely(&self, pair: [SegmentRef; 2], wanted: Justification, rng: &mut impl Rng) -> bool {
        match pair.map(|segment| self.guess(segment)) {
            [Some(left), Some(right)] => named([left, right], self.default) == wanted,
            _ => rng.random_bool(0.5),
        }
    }

    /// A clip that begins near one of `dreams` that was said to show `justification`: in a dream by chance, and there where it
    /// happens, so that what was asked often is not asked more often for that.
    fn near_one_that_shows(
        &self,
        justification: Justification,
        dreams: &[(DreamId, usize)],
        rng: &mut impl Rng,
    ) -> Option<SegmentRef> {
        let shows =
            |(_, shown): &(&usize, &Shown)| shown.is_some_and(|active| active.contains(justification));
        let of = |&(dream, len): &(DreamId, usize)| {
            let last = len.checked_sub(SEGMENT_LEN)?;
            let clips = self.clips.get(&dream)?;
            clips.iter().any(|clip| shows(&clip)).then_some((dream, last, clips))
        };
        let (dream, last, clips) = dreams.iter().filter_map(of).choose(rng)?;
        let place = rng.random_range(0..=last);
        let (start, _) = clips.iter().filter(shows).min_by_key(|(start, _)| start.abs_diff(place))?;
        let starts = start.saturating_sub(NEAR)..=(start + NEAR).min(last);
        (!starts.is_empty()).then(|| SegmentRef { dream, start: rng.random_range(starts) })
    }
}

/// Which justification an answer names of clips that show these: the most severe that tells them apart, or that both show.
fn named([left, right]: [Shown; 2], default: Justification) -> Justification {
    let only = |one: Shown, other: Shown| {
        let mut these = one.into_iter().flat_map(Active::iter);
        these.find(|it| !other.is_some_and(|other| other.contains(*it)))
    };
    let apart = only(left, right).into_iter().chain(only(right, left)).min();
    apart.or(left.map(Active::most_severe)).unwrap_or(default)
}

/// A pair by chance, but of those that are likely unsafe on both sides none, and of those that are so on one only half.
///
/// What is likely follows from what is `known`, and what is not known may be either. Nothing comes where no dream is long
/// enough.
// DIFFERENCE: in the paper every pair is as likely as any other (method §6). Ours does so too unless this is asked for.
pub fn sample_balanced(
    dreams: &[(DreamId, usize)],
    known: &KnownClips,
    rng: &mut impl Rng,
) -> Option<[SegmentRef; 2]> {
    let mut pair = sample_pair(dreams, rng)?;
    for _ in 1..N_TRIES {
        if rng.random_bool(known.share_kept(pair)) {
            break;
        }
        pair = sample_pair(dreams, rng)?;
    }
    Some(pair)
}

/// A pair whose answer will likely name the justification that was named least so far.
///
/// One clip is from around one that was said to show it, the other by chance from what does not hide it; for the default both
/// are from what was said to be safe. Nothing comes where no dream is long enough.
// DIFFERENCE: as for `sample_balanced`. By chance, what is seldom or less severe than something frequent hardly ever decides.
pub fn sample_least_answered(
    dreams: &[(DreamId, usize)],
    known: &KnownClips,
    rng: &mut impl Rng,
) -> Option<[SegmentRef; 2]> {
    let wanted = known.least_named();
    let mut pair = sample_pair(dreams, rng)?;
    for _ in 1..N_TRIES {
        if wanted != known.default
            && let Some(near) = known.near_one_that_shows(wanted, dreams, rng)
        {
            pair[usize::from(rng.random_bool(0.5))] = near;
        }
        if known.is_likely(pair, wanted, rng) {
            break;
        }
        pair = sample_pair(dreams, rng)?;
    }
    Some(pair)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const GRASS: Justification = Justification(0);
    const CHUCKHOLE: Justification = Justification(1);

    fn at(start: usize) -> SegmentRef {
        SegmentRef { dream: DreamId(0), start }
    }

    fn nothing() -> KnownClips {
        let named = [("grass", 1.0), ("chuckhole", 1.0), ("default", 0.75)];
        KnownClips::new(&Justifications::new(named).unwrap())
    }

    #[test]
    fn a_clip_is_likely_what_the_nearest_was_said_to_be() {
        let mut known = nothing();
        known.record([at(100), at(160)], Response::Safety(SafetyAnswer::OnlyLeft));
        known.record([at(500), at(600)], Response::Skipped(None));
        assert_eq!([129, 131, 59].map(|start| known.is_safe(at(start))), [Some(true), Some(false), None]);
        assert_eq!([500, 600].map(|start| known.is_safe(at(start))), [None, None], "nothing was said");
        assert_eq!(known.is_safe(SegmentRef { dream: DreamId(1), start: 100 }), None, "nor of other dreams");
    }

    #[test]
    fn few_pairs_are_unsafe_on_both_sides_and_more_are_safe() {
        // Of this dream it is known that its first half is unsafe.
        let mut known = nothing();
        for start in (0..981).step_by(20) {
            let answer =
                if start < 500 { SafetyAnswer::Neither } else { SafetyAnswer::Both(Preference::Equal) };
            known.record([at(start), at(start)], Response::Safety(answer));
        }
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        let mut counts = [0; 3];
        for _ in 0..1000 {
            let pair = sample_balanced(&[(DreamId(0), 1000)], &known, rng).unwrap();
            counts[pair.iter().filter(|segment| known.is_safe(**segment) == Some(true)).count()] += 1;
        }
        // By chance they would be 250, 500 and 250; none of the first and half of the second leave as many as of the last.
        assert_eq!(counts[0], 0);
        assert!((430..570).contains(&counts[1]), "{counts:?}");
    }

    #[test]
    fn where_all_is_known_to_be_unsafe_something_is_asked_all_the_same() {
        let mut known = nothing();
        known.record([at(0), at(10)], Response::Safety(SafetyAnswer::Neither));
        let rng = &mut ChaCha8Rng::seed_from_u64(0);
        for sample in [sample_balanced, sample_least_answered] {
            assert!(sample(&[(DreamId(0), 30)], &known, rng).is_some());
            assert_eq!(sample(&[(DreamId(0), 10)], &known, rng), None, "none is long enough");
        }
    }

    #[test]
    fn the_most_severe_that_tells_clips_apart_is_named() {
        let (grass, chuckhole) = (Active::of(GRASS), Active::of(CHUCKHOLE));
        let default = Justification(2);
        for (left, right, expected) in [
            (None, None, default),
            (Some(chuckhole), None, CHUCKHOLE),
            (Some(chuckhole), Some(grass), GRASS),
            (Some(grass.with(CHUCKHOLE)), Some(grass), CHUCKHOLE),
            (Some(grass), Some(grass), GRASS),
        ] {
            assert_eq!(named([left, right], default), expected, "{left:?} and {right:?}");
            assert_eq!(named([right, left], default), expected, "{right:?} and {left:?}");
        }
    }

    #[test]
    fn what_is_seldom_is_asked_about_until_it_was_answered_as_often() {
        // Half of the dream is grass, and of a hundred clips one shows a chuckhole: an annotator who sees that answers.
        let shows = |start: usize| match start {
            0..500 => Some(Active::of(GRASS)),
            690..710 => Some(Active::of(CHUCKHOLE)),
            _ => None,
        };
        let answer = |pair: [SegmentRef; 2]| {
            let [left, right] = pair.map(|segment| shows(segment.start));
            let why = named([left, right], Justification(2));
            let has = |shown: Shown| shown.is_some_and(|active| active.contains(why));
            Response::Justified(
                why.into(),
                match [has(left), has(right)] {
                    [true, false] => Preference::Right,
                    [false, true] => Preference::Left,
                    _ => Preference::Equal,
                },
            )
        };
        let counts = |sample: fn(&[(DreamId, usize)], &KnownClips, &mut ChaCha8Rng) -> _| {
            let (mut known, rng) = (nothing(), &mut ChaCha8Rng::seed_from_u64(0));
            for _ in 0..600 {
                let pair: Option<[SegmentRef; 2]> = sample(&[(DreamId(0), 1000)], &known, rng);
                known.record(pair.unwrap(), answer(pair.unwrap()));
            }
            [GRASS, CHUCKHOLE, Justification(2)].map(|it| known.n_named.get(&it).copied().unwrap_or(0))
        };
        let by_chance = counts(|dreams, _, rng| sample_pair(dreams, rng));
        let least = counts(sample_least_answered);
        assert!(by_chance[0] > 350 && by_chance[1] < 40, "{by_chance:?}");
        assert!(least.iter().all(|n| *n > 130), "{least:?}");
    }
}
