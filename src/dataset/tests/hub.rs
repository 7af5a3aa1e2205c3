//! What the Hugging Face Hub and `LeRobot` look for.

use super::*;

fn card(dir: &Path) -> String {
    fs::read_to_string(dir.join("README.md")).unwrap()
}

#[test]
fn a_card_follows_the_episodes_until_somebody_changes_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert!(!dir.path().join("README.md").exists(), "of nothing there is no card");
    seal(&mut dataset, 1, 3);
    assert!(card(dir.path()).contains("1 episode with 3 steps"), "{}", card(dir.path()));
    seal(&mut dataset, 2, 4);
    assert!(card(dir.path()).contains("2 episodes with 7 steps"), "{}", card(dir.path()));
    assert!(card(dir.path()).contains("data_files: data/*/*.parquet"));
    let mine = card(dir.path()).replace("None is stated yet.", "CC-BY 4.0.");
    put(dir.path(), "README.md", &mine);
    put(dir.path(), ".gitignore", "/journal/\n/notes/\n");
    seal(&mut dataset, 3, 5);
    drop(dataset);
    Dataset::create_or_open(dir.path(), "dummy").unwrap();
    assert_eq!(card(dir.path()), mine);
    assert_eq!(fs::read_to_string(dir.path().join(".gitignore")).unwrap(), "/journal/\n/notes/\n");
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    (0..3).for_each(|_| dataset.delete(0).unwrap());
    assert_eq!(card(dir.path()), mine, "nor is it removed with the last episode");
}

#[test]
fn the_last_episode_takes_its_card_with_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::create_or_open(dir.path(), "dummy").unwrap();
    seal(&mut dataset, 1, 3);
    assert!(fs::read_to_string(dir.path().join(".gitignore")).unwrap().contains("/journal/"));
    dataset.delete(0).unwrap();
    assert!(!dir.path().join("README.md").exists() && !dir.path().join(".gitignore").exists());
}

#[test]
fn what_goes_to_the_hub_has_no_journal_and_nothing_deleted() {
    let (dir, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut dataset = four(dir.path());
    let recording = record(&dataset, 9, 2);
    dataset.delete(1).unwrap();
    put(dir.path(), "README.md", "my own words");
    put(dir.path(), "thesis.txt", "not of the dataset");
    let mut told = Vec::new();
    dataset.write_for_hub(to.path(), |done, n| told.push((done, n))).unwrap();
    assert_eq!(told, [(0, 3), (1, 3), (2, 3)]);
    let mut names: Vec<_> = fs::read_dir(to.path()).unwrap().map(|it| it.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, [".gitignore", "README.md", "data", "meta"]);
    assert_eq!(card(to.path()), "my own words");
    let written = Dataset::open(to.path()).unwrap();
    let mut both = written.episodes().zip(dataset.episodes());
    assert!(both.all(|(one, other)| one.unwrap() == other.unwrap()));
    assert_eq!(written.n_episodes(), 3);
    recording.discard().unwrap();
}

#[test]
fn recordings_of_an_older_version_get_quantiles_and_features_on_their_way_to_the_hub() {
    let (dir, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    put(
        dir.path(),
        "data/chunk-000/file-000.parquet",
        include_bytes!("../../../tests/golden/episode-format-2.parquet"),
    );
    let old = Dataset::open(dir.path()).unwrap();
    assert!(old.episodes[0].stats["action"].quantiles.is_empty());
    old.write_for_hub(to.path(), |_, _| ()).unwrap();
    let new = Dataset::open(to.path()).unwrap();
    assert!(new.episodes[0].stats.values().all(|stats| stats.quantiles.len() == 5));
    assert_eq!(new.episode(0).unwrap(), old.episode(0).unwrap());
    let file = fs::read(episode_file(to.path(), 0)).unwrap();
    let footer = super::super::table::Footer::read(&mut std::io::Cursor::new(file)).unwrap();
    let told: serde_json::Value = serde_json::from_str(footer.note("huggingface").unwrap()).unwrap();
    let features = &told["info"]["features"];
    assert_eq!(features["observation.image"]["_type"], "Image");
    assert_eq!(features["action"]["length"], 3);
    let stats = fs::read(to.path().join("meta/stats.json")).unwrap();
    let stats: serde_json::Value = serde_json::from_slice(&stats).unwrap();
    assert_eq!(stats["observation.image"]["q99"].as_array().unwrap().len(), 3);
    assert_eq!(stats["action"]["q01"].as_array().unwrap().len(), 3);
}
