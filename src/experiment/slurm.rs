//! An array job that runs the trials of a folder on a cluster. The cluster schedules; nothing here does.

use std::fmt::Write as _;
use std::path::Path;

/// How the job is cut.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArrayJob {
    /// So many tasks at a time.
    pub at_a_time: usize,
    /// Processors of a task.
    pub cpus: usize,
    /// More lines for the head of the script, such as `--partition=gpu`.
    pub options: Vec<String>,
}

/// Numbers as an array names them: `0-3,7`.
///
/// ```
/// use dropj::experiment::slurm::ranges;
///
/// assert_eq!(ranges(&[0, 1, 2, 3, 7, 9, 10]), "0-3,7,9-10");
/// ```
pub fn ranges(tasks: &[usize]) -> String {
    let mut text = String::new();
    for run in tasks.chunk_by(|a, b| a + 1 == *b) {
        let comma = if text.is_empty() { "" } else { "," };
        let _ = match run {
            [one] => write!(text, "{comma}{one}"),
            [first, .., last] => write!(text, "{comma}{first}-{last}"),
            [] => Ok(()),
        };
    }
    text
}

impl ArrayJob {
    /// The script of an array over `tasks` of the experiment in `dir`, which `program` runs. What a task writes goes into files
    /// beside its rows.
    pub fn script(&self, program: &Path, dir: &Path, name: &str, tasks: &[usize]) -> String {
        let (dir, program) = (dir.display().to_string(), program.display().to_string());
        let mut text = format!(
            "#!/bin/bash\n#SBATCH --job-name=dropj-{name}\n#SBATCH --array={}%{}\n#SBATCH --cpus-per-task={}\n#SBATCH --open-mode=append\n\
             #SBATCH --output=\"{}/trials/%a.out\"\n",
            ranges(tasks),
            self.at_a_time.max(1),
            self.cpus.max(1),
            escaped(&dir)
        );
        for option in &self.options {
            let _ = writeln!(text, "#SBATCH {option}");
        }
        // In place of the shell: so that the program, and not its shell, is told to end.
        let _ = writeln!(
            text,
            "exec {} experiment --task \"$SLURM_ARRAY_TASK_ID\" --out {}",
            quoted(&program),
            quoted(&dir)
        );
        text
    }

    /// The script that puts together what the tasks brought, once all have ended.
    pub fn collecting(&self, program: &Path, dir: &Path, name: &str) -> String {
        let (dir, program) = (dir.display().to_string(), program.display().to_string());
        let options =
            self.options.iter().fold(String::new(), |text, option| text + "#SBATCH " + option + "\n");
        format!(
            "#!/bin/bash\n#SBATCH --job-name=dropj-{name}-collect\n#SBATCH --output=\"{}/collect.out\"\n{options}exec {} experiment --collect \
             --out {}\n",
            escaped(&dir),
            quoted(&program),
            quoted(&dir)
        )
    }
}

/// A word for the shell.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// A path between quotes in the head of a script, where `%` means something.
fn escaped(path: &str) -> String {
    path.replace('\\', "\\\\").replace('"', "\\\"").replace('%', "%%")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_runs_each_missing_task_and_no_other() {
        let job = ArrayJob { at_a_time: 2, cpus: 1, options: vec!["--partition=main".to_owned()] };
        let text = job.script(Path::new("/opt/drop j/dropj"), Path::new("/data/it's"), "weights", &[0, 1, 5]);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "#!/bin/bash", "which sbatch wants first");
        assert!(lines.contains(&"#SBATCH --array=0-1,5%2") && lines.contains(&"#SBATCH --partition=main"));
        let last =
            "exec '/opt/drop j/dropj' experiment --task \"$SLURM_ARRAY_TASK_ID\" --out '/data/it'\\''s'";
        assert_eq!(lines.last(), Some(&last));
        let collecting = job.collecting(Path::new("dropj"), Path::new("out"), "weights");
        assert!(collecting.ends_with("exec 'dropj' experiment --collect --out 'out'\n"), "{collecting}");
        assert_eq!((ranges(&[]), ranges(&[4])), (String::new(), "4".to_owned()));
    }
}
