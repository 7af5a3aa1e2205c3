//! Colors and sizes: one table for each theme, and nothing is colored by any other.

use eframe::egui::style::ScrollAnimation;
use eframe::egui::{
    Color32, Context, CornerRadius, FontFamily, FontId, Margin, RichText, Shadow, Stroke, Style, TextStyle,
    Theme, Ui, Visuals, vec2,
};

/// Half the room between two cards, and the whole room inside a group.
pub(crate) const GAP: f32 = 12.0;
/// The room around a panel.
pub(crate) const PAD: f32 = 24.0;
/// The corner of a card.
pub(crate) const CORNER: CornerRadius = CornerRadius::same(8);
/// The corner of a control.
pub(crate) const SMALL_CORNER: CornerRadius = CornerRadius::same(6);
/// The height of a control.
pub(crate) const CONTROL: f32 = 34.0;

/// The colors of a theme.
#[derive(Debug, PartialEq)]
pub(crate) struct Tokens {
    /// Behind everything.
    pub background: Color32,
    /// The rail and the status bar.
    pub rail: Color32,
    /// A card.
    pub surface: Color32,
    /// A control on a card.
    pub raised: Color32,
    /// The place on the rail where one is.
    pub here: Color32,
    /// The same under the pointer.
    pub hovered: Color32,
    /// Around cards and controls.
    pub border: Color32,
    /// What is read first.
    pub text: Color32,
    /// What is read second.
    pub muted: Color32,
    /// What is only there to be found.
    pub faint: Color32,
    /// The one thing to do next.
    pub accent: Color32,
    /// Text on it.
    pub on_accent: Color32,
    /// Safe, kept, done.
    pub good: Color32,
    /// Unsafe, late, not yet.
    pub warn: Color32,
    /// Failed.
    pub bad: Color32,
    /// Behind a picture.
    pub stage: Color32,
    /// Lines of a plot, one after the other.
    pub lines: [Color32; 3],
    /// Runs, one after the other, which people who see fewer colors tell apart, too (Okabe and Ito): as in saved figures.
    pub runs: [Color32; 8],
}

const fn rgb(hex: u32) -> Color32 {
    Color32::from_rgb((hex >> 16) as u8, (hex >> 8) as u8, hex as u8)
}

const RUNS: [Color32; 8] = [
    rgb(0x00_72b2),
    rgb(0xd5_5e00),
    rgb(0x00_9e73),
    rgb(0xcc_79a7),
    rgb(0x56_b4e9),
    rgb(0xe6_9f00),
    rgb(0x5a_5a5a),
    rgb(0x96_6e3c),
];

/// Blue and gray are lighter before a dark ground.
const RUNS_IN_THE_DARK: [Color32; 8] =
    [rgb(0x2b_8fcc), RUNS[1], RUNS[2], RUNS[3], rgb(0x86_ccf3), RUNS[5], rgb(0xa8_a8a8), rgb(0xb0_8a5a)];

static DARK: Tokens = Tokens {
    background: rgb(0x15_171b),
    rail: rgb(0x10_1215),
    surface: rgb(0x1c_1f24),
    raised: rgb(0x26_2a31),
    here: rgb(0x26_2a31),
    hovered: rgb(0x30_353e),
    border: rgb(0x2d_323a),
    text: rgb(0xe7_e9ed),
    muted: rgb(0xa3_abb8),
    faint: rgb(0x77_808f),
    accent: rgb(0x7f_aef5),
    on_accent: rgb(0x0e_1624),
    good: rgb(0x6c_c497),
    warn: rgb(0xe3_ad62),
    bad: rgb(0xe8_7c7c),
    stage: rgb(0x0b_0c0e),
    lines: [rgb(0x7f_aef5), rgb(0x6c_c497), rgb(0xe3_ad62)],
    runs: RUNS_IN_THE_DARK,
};

static LIGHT: Tokens = Tokens {
    background: rgb(0xf6_f7f9),
    rail: rgb(0xec_eef2),
    surface: rgb(0xff_ffff),
    raised: rgb(0xf0_f2f5),
    here: rgb(0xff_ffff),
    hovered: rgb(0xe4_e8ee),
    border: rgb(0xd9_dde4),
    text: rgb(0x1b_1f26),
    muted: rgb(0x52_5b69),
    faint: rgb(0x72_7b89),
    accent: rgb(0x2a_62c9),
    on_accent: rgb(0xff_ffff),
    good: rgb(0x16_7148),
    warn: rgb(0x8f_560c),
    bad: rgb(0xb0_3030),
    stage: rgb(0xe2_e5ea),
    lines: [rgb(0x2a_62c9), rgb(0x16_7148), rgb(0xb0_6b12)],
    runs: RUNS,
};

impl Tokens {
    /// Those of the present theme.
    pub(crate) fn of(ui: &Ui) -> &'static Self {
        Self::when(ui.visuals().dark_mode)
    }

    fn when(is_dark: bool) -> &'static Self {
        if is_dark { &DARK } else { &LIGHT }
    }
}

/// Text of the largest size: a figure.
pub(crate) fn figure(text: impl Into<String>) -> RichText {
    RichText::new(text).font(FontId::proportional(24.0))
}

/// Text of the second size: what a panel is about.
pub(crate) fn title(text: impl Into<String>) -> RichText {
    RichText::new(text).font(FontId::proportional(21.0))
}

/// Text that explains.
pub(crate) fn muted(ui: &Ui, text: impl Into<String>) -> RichText {
    RichText::new(text).color(Tokens::of(ui).muted)
}

/// Small text beside something.
pub(crate) fn small(ui: &Ui, text: impl Into<String>) -> RichText {
    RichText::new(text).font(FontId::proportional(12.5)).color(Tokens::of(ui).muted)
}

/// Gives both themes of `ctx` our colors and sizes.
pub(crate) fn install(ctx: &Context) {
    for theme in [Theme::Dark, Theme::Light] {
        ctx.style_mut_of(theme, |style| dress(style, Tokens::when(theme == Theme::Dark), theme));
    }
}

/// Lets parts of the window move into their places, or has them there at once.
pub(crate) fn animate(ctx: &Context, is_wanted: bool) {
    let secs = if is_wanted { Style::default().animation_time } else { 0.0 };
    if ctx.global_style().animation_time != secs {
        ctx.all_styles_mut(|style| {
            style.animation_time = secs;
            style.scroll_animation =
                if is_wanted { ScrollAnimation::default() } else { ScrollAnimation::none() };
        });
    }
}

fn dress(style: &mut Style, tokens: &Tokens, theme: Theme) {
    let font = |size| FontId::new(size, FontFamily::Proportional);
    style.text_styles = [
        (TextStyle::Small, font(12.5)),
        (TextStyle::Body, font(14.5)),
        (TextStyle::Button, font(14.5)),
        (TextStyle::Heading, font(21.0)),
        (TextStyle::Monospace, FontId::new(13.0, FontFamily::Monospace)),
    ]
    .into();
    style.spacing.item_spacing = vec2(10.0, 8.0);
    style.spacing.button_padding = vec2(12.0, 6.0);
    style.spacing.interact_size.y = 30.0;
    style.spacing.window_margin = Margin::same(20);
    style.spacing.icon_width = 18.0;
    style.visuals = visuals(tokens, theme);
}

fn visuals(tokens: &Tokens, theme: Theme) -> Visuals {
    let mut visuals = if theme == Theme::Dark { Visuals::dark() } else { Visuals::light() };
    visuals.panel_fill = tokens.background;
    visuals.window_fill = tokens.surface;
    visuals.window_stroke = Stroke::new(1.0, tokens.border);
    visuals.window_corner_radius = CornerRadius::same(12);
    visuals.menu_corner_radius = CORNER;
    let shadow = Shadow { offset: [0, 6], blur: 24, spread: 0, color: Color32::from_black_alpha(60) };
    visuals.window_shadow = shadow;
    visuals.popup_shadow = shadow;
    visuals.extreme_bg_color = tokens.background;
    visuals.text_edit_bg_color = Some(tokens.background);
    visuals.faint_bg_color = tokens.raised;
    visuals.hyperlink_color = tokens.accent;
    visuals.warn_fg_color = tokens.warn;
    visuals.error_fg_color = tokens.bad;
    visuals.weak_text_color = Some(tokens.muted);
    visuals.selection.bg_fill = tokens.accent.gamma_multiply(0.35);
    visuals.selection.stroke = Stroke::new(1.0, tokens.text);
    let widgets = &mut visuals.widgets;
    for (widget, fill) in [
        (&mut widgets.noninteractive, tokens.surface),
        (&mut widgets.inactive, tokens.raised),
        (&mut widgets.hovered, tokens.hovered),
        (&mut widgets.active, tokens.hovered),
        (&mut widgets.open, tokens.raised),
    ] {
        widget.bg_fill = fill;
        widget.weak_bg_fill = fill;
        widget.bg_stroke = Stroke::new(1.0, tokens.border);
        widget.fg_stroke = Stroke::new(1.0, tokens.text);
        widget.corner_radius = SMALL_CORNER;
        widget.expansion = 0.0;
    }
    visuals
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance, WCAG 2.
    fn luminance(color: Color32) -> f32 {
        let channel = |value: u8| {
            let value = f32::from(value) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * channel(color.r()) + 0.7152 * channel(color.g()) + 0.0722 * channel(color.b())
    }

    fn contrast(a: Color32, b: Color32) -> f32 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn text_can_be_read_on_everything_it_stands_on() {
        for (name, tokens) in [("dark", &DARK), ("light", &LIGHT)] {
            for ground in [tokens.background, tokens.rail, tokens.surface] {
                for text in [tokens.text, tokens.muted, tokens.good, tokens.warn, tokens.bad, tokens.accent] {
                    assert!(contrast(text, ground) >= 4.5, "{name}: {text:?} on {ground:?}");
                }
                assert!(contrast(tokens.faint, ground) >= 3.0, "{name}: faint on {ground:?}");
            }
            assert!(contrast(tokens.on_accent, tokens.accent) >= 4.5, "{name}: on the accent");
        }
    }
}
