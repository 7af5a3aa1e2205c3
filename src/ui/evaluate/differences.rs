//! What the tests say of the runs that are shown.

use eframe::egui::{Grid, RichText, ScrollArea, Ui};

use crate::experiment::Verdict;
use crate::experiment::comparison::{LEAST_SEEDS, MOST_COMPARED, probability};
use crate::ui::View;
use crate::ui::tokens::{self, Tokens};

pub(super) fn differences_ui(ui: &mut Ui, state: &View<'_>) {
    let (tokens, evaluate) = (Tokens::of(ui), &state.evaluate);
    let (shown, measure) = (&evaluate.shown, &evaluate.measure);
    let Some(found) = &shown.comparison else {
        ui.label(tokens::muted(ui, "With two runs that are shown, the tests compare them."));
        return;
    };
    if shown.worlds.len() > 1 {
        let text = format!("These were driven in different worlds: {}.", shown.worlds.join(", "));
        ui.label(RichText::new(text).color(tokens.warn));
    }
    let mut said = Vec::new();
    if let Some(test) = found.friedman {
        said.push(format!(
            "Paired by seed and track ({} blocks): Friedman χ² = {:.1}, p {}.",
            found.n_blocks,
            test.chi2,
            told(test.p)
        ));
    } else if found.n_blocks == 0 {
        said.push("No seed and track was driven by all of them, so all together are not paired.".to_owned());
    }
    if let Some(test) = found.kruskal_wallis {
        said.push(format!(
            "As the paper tests, episodes taken for independent: Kruskal–Wallis H = {:.1}, p {}.",
            test.h,
            told(test.p)
        ));
    }
    ui.label(said.join(" "));
    if found.n_seeds < 2 {
        let text = "Nothing is called different on one seed: another chain of dreams and answers may come out otherwise.";
        ui.label(RichText::new(text).color(tokens.warn));
    }
    if found.pairs.is_empty() {
        let text =
            format!("More than {MOST_COMPARED} runs are not compared two by two: leave some out above.");
        ui.label(tokens::muted(ui, text));
        return;
    }
    ScrollArea::horizontal().id_salt("pairs").show(ui, |ui| {
        Grid::new("pairs").num_columns(7).spacing([20.0, 4.0]).show(ui, |ui| {
            for (name, about) in [
                ("", ""),
                (
                    "Difference over seeds",
                    "The mean difference, and its interval of 95 % (percentile bootstrap)",
                ),
                ("Cliff's δ", "How much more often an episode of the first is the greater one, from −1 to 1"),
                ("Wilcoxon, Holm", "Paired by seed and track, and corrected for the number of pairs"),
                ("Dunn", "As the paper tests, episodes taken for independent"),
                ("", ""),
                (
                    "Seeds alone",
                    "The stricter test, which takes no two episodes of a seed for apart: Wilcoxon's signed ranks of the seeds' means, Holm's correction",
                ),
            ] {
                ui.label(tokens::small(ui, name)).on_hover_text(about);
            }
            ui.end_row();
            for pair in &found.pairs {
                let name = |i: usize| &shown.groups[i].1.name;
                ui.label(format!("{} − {}", name(pair.of.0), name(pair.of.1)));
                ui.label(pair.difference.map_or("–".to_owned(), |all| {
                    let [mean, low, high] = all.map(|value| measure.shown(value));
                    format!("{mean} [{low}, {high}]")
                }));
                ui.label(format!("{:+.2}", pair.delta));
                ui.label(if pair.n_blocks == 0 { "–".to_owned() } else { probability(pair.wilcoxon) });
                ui.label(pair.dunn.map_or("–".to_owned(), probability));
                let (ink, verdict) = match pair.verdict {
                    Verdict::Differ => (tokens.text, RichText::new(pair.verdict.in_words()).strong()),
                    Verdict::NotToldApart | Verdict::Unpaired | Verdict::OneSeed => {
                        (tokens.muted, RichText::new(pair.verdict.in_words()))
                    }
                };
                ui.label(verdict.color(ink));
                let few = format!("Nothing is said on fewer than {LEAST_SEEDS} seeds");
                match pair.seeds_alone {
                    Some(p) => ui.label(probability(p)),
                    None => ui.label(tokens::muted(ui, "–")).on_hover_text(few),
                };
                ui.end_row();
            }
        });
    });
}

/// `= 0.0312`, `< 0.0001`.
fn told(p: f64) -> String {
    let text = probability(p);
    if text.starts_with('<') { text } else { format!("= {text}") }
}
