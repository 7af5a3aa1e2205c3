//! What the steps of a dataset's episodes have, and the columns of their events.

use serde::{Deserialize, Serialize};

use super::legacy;
use crate::world::WorldSpec;

/// What the steps of a dataset's episodes have, beside picture and reward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Layout {
    /// What the numbers of an action are called.
    pub axes: Vec<String>,
    /// What can go on after a step.
    pub events: Vec<String>,
    /// What is measured beside the picture.
    pub sensors: Vec<String>,
    /// Steps a second, in Hz.
    pub rate: f64,
}

impl Layout {
    /// That of recordings of a world, in which `sensors` are measured.
    pub fn of(spec: &WorldSpec, sensors: &[String]) -> Self {
        Self {
            axes: spec.axes.iter().map(|axis| axis.name.clone()).collect(),
            events: spec.events.iter().map(|event| event.name.clone()).collect(),
            sensors: sensors.to_vec(),
            rate: spec.rate,
        }
    }

    /// Which of its events has this name.
    pub(super) fn event(&self, name: &str) -> Option<usize> {
        self.events.iter().position(|event| event == name)
    }
}

impl Default for Layout {
    /// What datasets mean that were recorded before worlds were described: the built-in car on a road.
    fn default() -> Self {
        legacy::layout(false)
    }
}

/// The column that tells in which steps an event goes on: `next.` and its name in small letters, in which an underscore
/// stands for whatever lies between letters and digits.
pub(super) fn column(event: &str) -> String {
    let mut column = String::from("next.");
    let mut is_between = false;
    for sign in event.chars() {
        if sign.is_alphanumeric() {
            column.extend(sign.to_lowercase());
        } else if !is_between {
            column.push('_');
        }
        is_between = !sign.is_alphanumeric();
    }
    column
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_has_a_column_that_other_programs_can_name() {
        for (event, wanted) in [
            ("grass", "next.grass"),
            ("new tile", "next.new_tile"),
            ("Left arm / elbow: 2", "next.left_arm_elbow_2"),
            ("é!", "next.é_"),
        ] {
            assert_eq!(column(event), wanted);
        }
    }

    #[test]
    fn a_worlds_layout_has_its_names_in_their_order() {
        let spec = WorldSpec::built_in("obstacle-car-racing").expect("it is built in");
        let layout = Layout::of(&spec, &["speed".to_owned()]);
        assert_eq!(layout.events, ["grass", "new tile", "chuckhole", "car"]);
        assert_eq!((layout.axes, layout.sensors.len()), (Layout::default().axes, 1));
        assert_eq!((layout.rate, layout.sensors[0].as_str()), (Layout::default().rate, "speed"));
    }
}
