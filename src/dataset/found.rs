//! The files that lie where a dataset has its episodes: ours, torn ones, and those of others.

use std::path::{Path, PathBuf};

use super::damage::Damage;
use super::notes::Notes;
use super::{DatasetError, disk, sealed};

/// What lies among a dataset's episodes.
pub(super) struct Found {
    /// Ours, in the order of their files.
    pub(super) episodes: Vec<Notes>,
    /// Torn files, why, and where.
    pub(super) torn: Vec<(Damage, PathBuf)>,
    /// Whole files that are none of ours.
    pub(super) others: Vec<DatasetError>,
}

impl Found {
    /// Reads the footers of all files.
    pub(super) fn read(dir: &Path) -> Result<Self, DatasetError> {
        let (mut episodes, mut torn, mut others) = (Vec::new(), Vec::new(), Vec::new());
        for path in disk::data_files(dir)? {
            match sealed::open(&path) {
                Ok(notes) => episodes.push(notes),
                Err(DatasetError::Damaged { reason, path }) => torn.push((reason, path)),
                Err(error @ DatasetError::NotOurs { .. }) => others.push(error),
                Err(error) => return Err(error),
            }
        }
        Ok(Self { episodes, torn, others })
    }

    /// All episodes of a dataset are of one world and have the same columns.
    pub(super) fn require_alike(&self) -> Result<(), DatasetError> {
        let Some((first, rest)) = self.episodes.split_first() else { return Ok(()) };
        rest.iter().try_for_each(|other| sealed::require_alike(first, other))
    }
}
