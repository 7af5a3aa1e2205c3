//! Who answered, how fast and how steadily, and how far those agree who answered the same queries.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;

use crate::evaluation::Agreement;
use crate::query::{Query, Response, SkipReason, Transition};
use crate::session::statistics::IDLE_SECS;
use crate::session::{AskedQuery, Session};
use crate::text::cell;

/// One who answered.
#[derive(Clone, Debug, PartialEq)]
pub struct AnnotatorReport {
    /// As the answers say it.
    pub name: String,
    /// Answers that count and are no skips. What was asked again is left out.
    pub n_answered: usize,
    /// Queries that were skipped.
    pub n_skipped: usize,
    /// Of these, how many did not look like the world.
    pub n_hallucinated: usize,
    /// Seconds spent with queries, those asked again included, at most a minute with each.
    pub active_secs: f32,
    /// The time of the middle answer, skips left out. At most a minute.
    pub median_secs: Option<f32>,
    /// How far they said the same when they were asked again.
    pub consistency: Option<Agreement>,
}

impl AnnotatorReport {
    /// Usable labels an hour, once some time was spent.
    pub fn labels_per_hour(&self) -> Option<f32> {
        let rate = 3600.0 * self.n_answered as f32 / self.active_secs;
        rate.is_finite().then_some(rate)
    }
}

/// All who answered in some sessions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Annotators {
    /// Each of them, by name.
    pub each: Vec<AnnotatorReport>,
    /// Any two who answered the same queries, and how far they agree.
    pub pairs: Vec<([String; 2], Agreement)>,
    /// What whoever reads this should know: sessions that hold the same answers, names that occur in several.
    pub notes: Vec<String>,
}

/// What tells an answer from every other, wherever it was copied: who gave it, when, to what, and what was said.
#[derive(PartialEq, Eq, Hash)]
struct Mark<'a> {
    annotator: &'a str,
    at: u64,
    shown: Shown<'a>,
    /// Nothing where only the time spent is meant.
    said: Option<Response>,
    secs: u32,
}

/// Answers that were met before, and how often in one session.
#[derive(Default)]
struct Met<'a> {
    before: HashMap<Mark<'a>, usize>,
    here: HashMap<Mark<'a>, usize>,
}

impl<'a> Met<'a> {
    /// Whether this one is new: not one of those of the sessions before, which a copy holds too.
    fn is_new(&mut self, mark: Mark<'a>) -> bool {
        let n_before = self.before.get(&mark).copied().unwrap_or_default();
        let n_here = self.here.entry(mark).or_default();
        *n_here += 1;
        *n_here > n_before
    }

    /// Goes on with the next session.
    fn end_session(&mut self) {
        for (mark, n) in self.here.drain() {
            let before = self.before.entry(mark).or_default();
            *before = n.max(*before);
        }
    }
}

/// Nobody's name: what answers are called until somebody gives one.
const NOBODY: [&str; 2] = ["anonymous", ""];

/// A segment by the content of its dream, whatever its number in a session.
type Place<'a> = (&'a str, usize);

/// What a query shows: both places, and the step that is asked about, where it is a single one.
type Shown<'a> = ([Place<'a>; 2], Option<usize>);

/// What an annotator did.
#[derive(Default)]
struct Work<'a> {
    n_skipped: usize,
    n_hallucinated: usize,
    active_secs: f32,
    secs: Vec<f32>,
    repeated: Vec<(Response, Response)>,
    /// By pair of segments, and seen with the lesser one on the left.
    said: BTreeMap<Shown<'a>, Response>,
}

impl Annotators {
    /// Those of `sessions`, each with a name by which its annotators are called where they are given none of their own.
    ///
    /// Answers of one name are those of one person, in whatever session. One that is called so itself gives its name to
    /// its annotator, or to each of several behind their own.
    /// Two queries are the same where they show the same segments of the same dreams, on whichever side.
    /// An answer that stands in several sessions, because one is a copy or was put together from others, counts once.
    ///
    /// # Examples
    ///
    /// ```
    /// use dropj::query::{Protocol, Weights};
    /// use dropj::session::{Annotators, Session};
    ///
    /// let session = Session::new(Protocol::Dropj, Weights::paper());
    /// assert!(Annotators::of(&[(None, &session)]).each.is_empty(), "nobody has answered yet");
    /// ```
    pub fn of(sessions: &[(Option<&str>, &Session)]) -> Self {
        let name = |i: usize, annotator: &str| {
            let (called, session): (Option<&str>, &Session) = sessions[i];
            match called {
                None => annotator.to_owned(),
                Some(called) if session.active_secs().count() <= 1 => called.to_owned(),
                Some(called) => format!("{annotator} in {called}"),
            }
        };
        let (mut found, new) =
            Self::named(&sessions.iter().map(|(_, session)| *session).collect::<Vec<_>>(), name);
        let called = sessions.iter().filter_map(|(called, session)| Some(((*called)?, *session)));
        found.notes.extend(copies(called, &new));
        found
    }

    /// Those of sessions by their unmistakable names, such as [`distinct`](crate::text::distinct) gives them.
    ///
    /// A name is one person in all of them, which [`Self::notes`] tells, but for those who gave none: they are called
    /// after their sessions.
    pub fn of_sessions(sessions: &[(String, &Session)]) -> Self {
        let all: Vec<_> = sessions.iter().map(|(_, session)| *session).collect();
        let is_nobody = |annotator: &str| NOBODY.contains(&annotator.trim());
        let answered = |annotator: &str| {
            all.iter().filter(|session| session.active_secs().any(|(name, _)| name == annotator)).count()
        };
        let (mut found, new) = Self::named(&all, |i, annotator| {
            if is_nobody(annotator) && answered(annotator) > 1 {
                format!("{annotator} in {}", sessions[i].0)
            } else {
                annotator.to_owned()
            }
        });
        found.notes.extend(copies(sessions.iter().map(|(name, session)| (name.as_str(), *session)), &new));
        let mut places: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for ((name, _), new) in sessions.iter().zip(&new) {
            new.iter()
                .filter(|who| !is_nobody(who))
                .for_each(|who| places.entry(who).or_default().push(name));
        }
        for (who, sessions) in places.into_iter().filter(|(_, sessions)| sessions.len() > 1) {
            found.notes.push(format!("{who} in {} is taken for one person", sessions.join(" and ")));
        }
        found
    }

    /// Those of `sessions` by the names that `name` gives to an annotator of the session of this number; and who gave
    /// answers in each that are in none before it.
    fn named<'a>(
        sessions: &[&'a Session],
        name: impl Fn(usize, &str) -> String,
    ) -> (Self, Vec<BTreeSet<&'a str>>) {
        let mut work: BTreeMap<String, Work<'a>> = BTreeMap::new();
        let (mut met, mut new) = (Met::default(), Vec::new());
        for (i, session) in sessions.iter().enumerate() {
            let mut answered = BTreeSet::new();
            for spent in &session.spent {
                let Some(asked) = session.query(spent.query) else { continue };
                let (annotator, shown) = (spent.annotator.as_str(), session.shown(asked).0);
                let mark = Mark { annotator, at: spent.at, shown, said: None, secs: spent.secs.to_bits() };
                if met.is_new(mark) {
                    work.entry(name(i, annotator)).or_default().active_secs += spent.secs.min(IDLE_SECS);
                    answered.insert(annotator);
                }
            }
            for asked in session.queries() {
                let Some(given) = asked.answer() else { continue };
                let (annotator, shown) = (given.answer.annotator.as_str(), session.shown(asked).0);
                let said = Some(given.answer.response);
                let mark = Mark { annotator, at: given.at, shown, said, secs: given.answer.secs.to_bits() };
                if !met.is_new(mark) {
                    continue;
                }
                let work = work.entry(name(i, annotator)).or_default();
                if asked.repeats().is_some() {
                    work.repeated.extend(session.repeated_by(asked));
                } else {
                    work.take(session, asked);
                }
            }
            met.end_session();
            new.push(answered);
        }
        let default = sessions.first().map(|session| session.weights().justifications.default());
        let agreement = |pairs: &[(Response, Response)]| Agreement::of(pairs, default?);
        let report = |(name, work): (&String, &Work<'_>)| AnnotatorReport {
            name: name.clone(),
            n_answered: work.secs.len(),
            n_skipped: work.n_skipped,
            n_hallucinated: work.n_hallucinated,
            active_secs: work.active_secs,
            median_secs: median(&work.secs),
            consistency: agreement(&work.repeated),
        };
        let each = work.iter().map(report).collect();
        let all: Vec<_> = work.iter().collect();
        let mut pairs = Vec::new();
        for (i, (one, mine)) in all.iter().enumerate() {
            for (other, theirs) in &all[i + 1..] {
                let both = mine.said.iter().filter_map(|(at, said)| Some((*said, *theirs.said.get(at)?)));
                if let Some(agreement) = agreement(&both.collect::<Vec<_>>()) {
                    pairs.push(([(*one).clone(), (*other).clone()], agreement));
                }
            }
        }
        (Self { each, pairs, notes: Vec::new() }, new)
    }

    /// A table: a line for each annotator, compared with themselves, and then one for any two of them.
    pub fn to_csv(&self) -> String {
        let mut csv = String::from(
            "annotator,other,answered,skipped,hallucinated,hours,labels_per_hour,median_secs,compared,same,critical,\
             other_differences,kappa,safety_kappa\n",
        );
        let number = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
        let compared = |agreement: Option<Agreement>| {
            let Some(found) = agreement else { return "0,,,,,".to_owned() };
            let (kappa, safety) = (number(found.kappa), number(found.safety_kappa));
            let Agreement { n, n_same, n_critical, .. } = found;
            format!("{n},{n_same},{n_critical},{},{kappa},{safety}", found.n_other())
        };
        for one in &self.each {
            let AnnotatorReport { n_answered, n_skipped, n_hallucinated, .. } = one;
            let hours = one.active_secs / 3600.0;
            let (rate, median) =
                (number(one.labels_per_hour().map(f64::from)), number(one.median_secs.map(f64::from)));
            let name = cell(&one.name);
            let found = compared(one.consistency);
            writeln!(
                csv,
                "{name},,{n_answered},{n_skipped},{n_hallucinated},{hours},{rate},{median},{found}"
            )
            .ok();
        }
        for ([one, other], agreement) in &self.pairs {
            writeln!(csv, "{},{},,,,,,,{}", cell(one), cell(other), compared(Some(*agreement))).ok();
        }
        csv
    }
}

impl<'a> Work<'a> {
    fn take(&mut self, session: &'a Session, asked: &AskedQuery) {
        let Some(answer) = asked.answer().map(|given| &given.answer) else { return };
        match answer.response {
            Response::Skipped(reason) => {
                self.n_skipped += 1;
                self.n_hallucinated += usize::from(reason == Some(SkipReason::Hallucinated));
            }
            // Whoever took an hour was elsewhere, and nobody takes longer than the world has been there.
            _ => self.secs.push(answer.secs.min(IDLE_SECS)),
        }
        let (shown, is_turned) = session.shown(asked);
        let said = if is_turned { answer.response.mirrored() } else { answer.response };
        self.said.entry(shown).or_insert(said);
    }
}

impl Session {
    /// What a query shows, with the lesser place first, and whether that turns its sides round.
    fn shown(&self, asked: &AskedQuery) -> (Shown<'_>, bool) {
        // A transition is where it is, whatever clip shows it.
        let Query { left, right, .. } = asked.query;
        let clips = [left, right].map(|segment| (segment.dream, segment.start));
        let places = asked.transition.map_or(clips, |Transition { dream, step, .. }| [(dream, step); 2]);
        let [left, right] = places.map(|(dream, step)| (self.dreams[dream.0 as usize].sha256.as_str(), step));
        let step = asked.transition.map(|transition| transition.step);
        if left <= right { (([left, right], step), false) } else { (([right, left], step), true) }
    }
}

/// What is to be known of sessions that give nothing `new`.
fn copies<'a>(sessions: impl Iterator<Item = (&'a str, &'a Session)>, new: &[BTreeSet<&str>]) -> Vec<String> {
    let is_copy = |session: &Session, new: &BTreeSet<&str>| new.is_empty() && !session.spent.is_empty();
    let copies = sessions.zip(new).filter(|((_, session), new)| is_copy(session, new));
    copies
        .map(|((name, _), _)| {
            format!("the answers of {name} all stand in the sessions before it, and count once")
        })
        .collect()
}

/// The middle number, or the mean of the middle two.
fn median(numbers: &[f32]) -> Option<f32> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f32::total_cmp);
    let n = sorted.len();
    (n > 0).then(|| f32::midpoint(sorted[(n - 1) / 2], sorted[n / 2]))
}

/// The dreams that sessions have in common are what makes their answers comparable.
pub fn share_dreams(one: &Session, other: &Session) -> bool {
    let hashes: BTreeSet<_> = one.dreams().iter().map(|kept| &kept.sha256).collect();
    other.dreams().iter().any(|kept| hashes.contains(&kept.sha256))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::{DreamId, Preference, Protocol, QueryId, SafetyAnswer, SegmentRef, Weights};
    use crate::session::{Answer, Choice, DreamSource, Entry, Event, KeptDream};

    /// The first steps of the left and right segment, each after its dream. What was said, and in how many seconds.
    type Said = ([(u32, usize); 2], Response, f32);

    /// A session over the dreams called `hashes`, with queries and their answers.
    fn session(hashes: &[&str], said: &[Said], annotator: &str) -> Session {
        let mut session = Session::new(Protocol::Dropj, Weights::paper());
        let mut happens = |event| {
            let entry = Entry { event, seq: session.n_entries(), at: 0 };
            session.apply(&entry).unwrap();
        };
        for (i, hash) in hashes.iter().enumerate() {
            happens(Event::DreamKept(KeptDream {
                dream: DreamId(i as u32),
                len: 100,
                seed: 0,
                marks: vec![],
                source: DreamSource::User,
                acquisition: None,
                planned: 0,
                file: "dreams/0000.safetensors".to_owned(),
                sha256: (*hash).to_owned(),
            }));
        }
        for (i, (pair, response, secs)) in said.iter().enumerate() {
            let query = QueryId(i as u32);
            let [left, right] = pair.map(|(dream, start)| SegmentRef { dream: DreamId(dream), start });
            happens(Event::Asked { query, left, right, choice: Choice::Uniform });
            happens(Event::Answered(Answer::new(query, *response, *secs, annotator)));
        }
        session
    }

    const LEFT: Response = Response::Safety(SafetyAnswer::OnlyLeft);
    const RIGHT: Response = Response::Safety(SafetyAnswer::OnlyRight);
    const EQUAL: Response = Response::Safety(SafetyAnswer::Both(Preference::Equal));

    #[test]
    fn the_same_segments_are_compared_whatever_their_numbers_and_sides() {
        let anna = session(
            &["one", "two"],
            &[
                ([(0, 5), (1, 7)], LEFT, 4.0),
                ([(0, 9), (0, 1)], LEFT, 2.0),
                ([(1, 0), (1, 50)], EQUAL, 9.0),
                ([(1, 1), (1, 51)], Response::Skipped(Some(SkipReason::Hallucinated)), 60.0),
            ],
            "anna",
        );
        let ben = session(
            &["two", "three", "one"],
            &[
                ([(0, 7), (2, 5)], RIGHT, 3.0),
                ([(2, 9), (2, 1)], RIGHT, 3.0),
                ([(1, 0), (1, 50)], EQUAL, 3.0),
                ([(0, 1), (0, 51)], EQUAL, 3.0),
            ],
            "ben",
        );
        let found = Annotators::of(&[(None, &anna), (None, &ben)]);
        let [(names, agreement)] = &found.pairs[..] else { panic!("{found:?}") };
        assert_eq!(names, &["anna".to_owned(), "ben".to_owned()]);
        // Both call the first the same, seen from one side; they contradict each other in the second; the third of
        // each is of another dream, and the fourth was skipped.
        assert_eq!((agreement.n, agreement.n_same, agreement.n_critical), (2, 1, 1));

        let anna = &found.each[0];
        assert_eq!((anna.n_answered, anna.n_skipped, anna.n_hallucinated), (3, 1, 1));
        assert_eq!((anna.median_secs, anna.active_secs), (Some(4.0), 75.0));
        assert_eq!(anna.labels_per_hour(), Some(144.0));
        assert_eq!(median(&[1.0, 2.0, 4.0, 8.0]), Some(3.0));
    }

    #[test]
    fn one_name_is_one_person_unless_sessions_are_told_apart() {
        let (once, again) = (
            session(&["one"], &[([(0, 5), (0, 7)], LEFT, 4.0)], "anna"),
            session(&["one"], &[([(0, 5), (0, 7)], RIGHT, 6.0)], "anna"),
        );
        let together = Annotators::of(&[(None, &once), (None, &again)]);
        assert_eq!((together.each.len(), together.pairs.len()), (1, 0));
        assert_eq!(together.each[0].median_secs, Some(5.0));
        let apart = Annotators::of(&[(Some("Monday, early"), &once), (Some("Tuesday"), &again)]);
        assert_eq!((apart.each.len(), apart.pairs.len()), (2, 1));
        insta::assert_snapshot!(apart.to_csv(), @r#"
        annotator,other,answered,skipped,hallucinated,hours,labels_per_hour,median_secs,compared,same,critical,other_differences,kappa,safety_kappa
        "Monday, early",,1,0,0,0.0011111111,900,4,0,,,,,
        Tuesday,,1,0,0,0.0016666667,600,6,0,,,,,
        "Monday, early",Tuesday,,,,,,,1,0,1,0,0,0
        "#);
        assert!(share_dreams(&once, &again), "they have a dream in common");
    }

    #[test]
    fn an_answer_that_was_copied_counts_once() {
        let said =
            [([(0, 5), (0, 7)], LEFT, 4.0), ([(0, 5), (0, 7)], LEFT, 4.0), ([(0, 9), (0, 7)], RIGHT, 3e38)];
        let once = session(&["one"], &said, "anna");
        let alone = Annotators::of(&[(None, &once)]);
        assert_eq!((alone.each[0].n_answered, alone.each[0].active_secs), (3, 68.0), "the same answer twice");
        let named = [("a".to_owned(), &once), ("b".to_owned(), &once)];
        let both = Annotators::of_sessions(&named);
        assert_eq!(both.each, alone.each);
        assert_eq!(both.notes, ["the answers of b all stand in the sessions before it, and count once"]);
    }

    #[test]
    fn those_without_a_name_are_told_apart_by_their_sessions() {
        let one = session(&["one"], &[([(0, 5), (0, 7)], LEFT, 4.0)], "anonymous");
        let other = session(&["one"], &[([(0, 5), (0, 7)], RIGHT, 6.0)], "anonymous");
        let found = Annotators::of_sessions(&[("a".to_owned(), &one), ("b".to_owned(), &other)]);
        let names: Vec<_> = found.each.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(
            (names, found.pairs.len(), found.notes.len()),
            (vec!["anonymous in a", "anonymous in b"], 1, 0)
        );
        let anna = session(&["one"], &[([(0, 5), (0, 7)], LEFT, 4.0)], "anna");
        let again = session(&["one"], &[([(0, 5), (0, 7)], LEFT, 5.0)], "anna");
        let found = Annotators::of_sessions(&[("a".to_owned(), &anna), ("b".to_owned(), &again)]);
        assert_eq!(found.each.len(), 1);
        assert_eq!(found.notes, ["anna in a and b is taken for one person"]);
    }

    #[test]
    fn a_session_of_several_keeps_their_names_apart() {
        let mut both =
            session(&["one"], &[([(0, 5), (0, 7)], LEFT, 4.0), ([(0, 1), (0, 7)], LEFT, 4.0)], "anna");
        let answer = Answer::new(QueryId(1), RIGHT, 1.0, "ben");
        both.apply(&Entry { event: Event::Answered(answer), seq: both.n_entries(), at: 0 }).unwrap();
        let found = Annotators::of(&[(Some("both"), &both)]);
        let names: Vec<_> = found.each.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["anna in both", "ben in both"]);
    }
}
