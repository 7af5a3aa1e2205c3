//! What an annotator can say, such that nothing contradictory can be said.

use serde::{Deserialize, Serialize};

use crate::query::{Active, Verdict};
use crate::world::WorldSpec;

/// Which questions are asked (method §7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// Left or right: strict preferences.
    Drop,
    /// Left, equal or right.
    Drope,
    /// Which clips stay safe. A preference only where both do.
    #[default]
    Dropj,
    /// The most severe justification that applies, and a preference (Eq. 2).
    DropjMulti,
    /// A verdict on each transition of trajectories that were made to be worth asking about.
    Request,
    /// A verdict on each transition of trajectories that the user dreamed.
    Dros,
}

impl Protocol {
    /// All of them, in the order of the paper.
    pub const ALL: [Self; 6] =
        [Self::Drop, Self::Drope, Self::Dropj, Self::DropjMulti, Self::Request, Self::Dros];

    /// What a session in this world asks where nothing else is said: whether it stays safe, or where several things must
    /// not happen, which of them does.
    pub fn of(spec: &WorldSpec) -> Self {
        if spec.justifications.len() > 1 { Self::DropjMulti } else { Self::Dropj }
    }

    /// The name in the paper.
    pub fn name(self) -> &'static str {
        match self {
            Self::Drop => "DROP",
            Self::Drope => "DROPe",
            Self::Dropj => "DROPJ",
            Self::DropjMulti => "DROPJ (multiple)",
            Self::Request => "ReQueST",
            Self::Dros => "DROS",
        }
    }

    /// Whether it asks about single transitions. The others ask about pairs of clips.
    pub fn is_sparse(self) -> bool {
        matches!(self, Self::Request | Self::Dros)
    }

    /// Whether `response` is one that this protocol asks for.
    pub fn permits(self, response: &Response) -> bool {
        match response {
            Response::Skipped(_) => true,
            Response::Preferred(Preference::Equal) => self == Self::Drope,
            Response::Preferred(_) => matches!(self, Self::Drop | Self::Drope),
            Response::Safety(_) => self == Self::Dropj,
            Response::Justified(..) => self == Self::DropjMulti,
            Response::Judged(_) => self.is_sparse(),
        }
    }
}

/// Which of two segments is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preference {
    /// The left one.
    Left,
    /// Neither is better.
    Equal,
    /// The right one.
    Right,
}

impl Preference {
    /// The same preference with the sides changed over.
    pub fn mirrored(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Equal => Self::Equal,
            Self::Right => Self::Left,
        }
    }
}

/// Which of two segments stay safe: the four cases of the paper's Table 1.
///
/// A preference exists only where both are safe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SafetyAnswer {
    /// Left is safe, right is not.
    OnlyLeft,
    /// Right is safe, left is not.
    OnlyRight,
    /// Both are unsafe.
    Neither,
    /// Both are safe, and this one is preferred.
    Both(Preference),
}

impl SafetyAnswer {
    /// The same answer with the sides changed over.
    pub fn mirrored(self) -> Self {
        match self {
            Self::OnlyLeft => Self::OnlyRight,
            Self::OnlyRight => Self::OnlyLeft,
            Self::Neither => Self::Neither,
            Self::Both(preference) => Self::Both(preference.mirrored()),
        }
    }
}

/// Why a query was left unanswered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The dream does not look like the world.
    Hallucinated,
    /// The clips cannot be told apart.
    Ambiguous,
    /// Something else.
    Other,
}

/// What the annotator did with a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// Left it, perhaps saying why.
    Skipped(Option<SkipReason>),
    /// Said which is better: DROP and DROPe.
    Preferred(Preference),
    /// Said which stay safe: DROPJ.
    Safety(SafetyAnswer),
    /// Said which justifications are active, and a preference: DROPJ with several justifications.
    Justified(Active, Preference),
    /// Said what a transition is worth: ReQueST and DROS.
    Judged(Verdict),
}

impl Response {
    /// Which clips stay safe, left and right. Nothing where the answer is not about safety.
    pub fn safety(self) -> Option<[bool; 2]> {
        let Self::Safety(answer) = self else { return None };
        Some(match answer {
            SafetyAnswer::OnlyLeft => [true, false],
            SafetyAnswer::OnlyRight => [false, true],
            SafetyAnswer::Neither => [false, false],
            SafetyAnswer::Both(_) => [true, true],
        })
    }

    /// The same as far as labels go: of several justifications only the one that is named.
    pub fn as_counted(self) -> Self {
        match self {
            Self::Justified(active, preference) => Self::Justified(active.most_severe().into(), preference),
            Self::Skipped(_) | Self::Preferred(_) | Self::Safety(_) | Self::Judged(_) => self,
        }
    }

    /// The same response with the sides changed over.
    pub fn mirrored(self) -> Self {
        match self {
            Self::Skipped(reason) => Self::Skipped(reason),
            Self::Preferred(preference) => Self::Preferred(preference.mirrored()),
            Self::Safety(answer) => Self::Safety(answer.mirrored()),
            Self::Justified(active, preference) => Self::Justified(active, preference.mirrored()),
            Self::Judged(verdict) => Self::Judged(verdict),
        }
    }
}
