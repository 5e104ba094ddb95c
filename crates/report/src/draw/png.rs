//! Conversion of SVG to PNG with an embedded font: the result is independent of system fonts.

use std::sync::{Arc, OnceLock};

use resvg::{tiny_skia, usvg};

use super::png_error::{DrawError, MAX_PIXELS};
use super::theme::Ink;

/// Renders `svg` as a PNG, `scale` pixels per unit.
pub(super) fn encode(svg: &str, scale: f64) -> Result<Vec<u8>, DrawError> {
    // The font has one weight: an outline imitates bold text.
    let heavy = format!(
        r#"font-weight="600" stroke="{}" stroke-width="0.45""#,
        Ink::Text.hex()
    );
    let tree = usvg::Tree::from_str(
        &svg.replace(r#"font-weight="600""#, &heavy),
        &usvg_options(),
    )?;
    let width = f64::from(tree.size().width()) * scale;
    let height = f64::from(tree.size().height()) * scale;
    let wrong_size = DrawError::Size {
        width: width.round(),
        height: height.round(),
    };
    // The comparison also rejects NaN.
    if !(width >= 0.5 && height >= 0.5 && width * height <= MAX_PIXELS) {
        return Err(wrong_size);
    }
    let columns = width.round() as u32;
    let rows = height.round() as u32;
    let mut pixels = tiny_skia::Pixmap::new(columns, rows).ok_or(wrong_size)?;
    let transform = tiny_skia::Transform::from_scale(scale as f32, scale as f32);
    resvg::render(&tree, transform, &mut pixels.as_mut());
    pixels
        .encode_png()
        .map_err(|error| DrawError::Encode(error.to_string()))
}

/// Returns parser options with exactly one font family, whatever the figure requests.
pub(super) fn usvg_options() -> usvg::Options<'static> {
    let fonts = font_database();
    let family = fonts
        .faces()
        .next()
        .and_then(|face| face.families.first())
        .map(|(name, _)| name.clone());
    usvg::Options {
        fontdb: fonts,
        font_family: family.unwrap_or_default(),
        ..usvg::Options::default()
    }
}

fn font_database() -> Arc<usvg::fontdb::Database> {
    static FONTS: OnceLock<Arc<usvg::fontdb::Database>> = OnceLock::new();
    Arc::clone(FONTS.get_or_init(load_fonts))
}

fn load_fonts() -> Arc<usvg::fontdb::Database> {
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(epaint_default_fonts::UBUNTU_LIGHT.to_vec());
    let family = fonts
        .faces()
        .next()
        .and_then(|face| face.families.first())
        .map(|(name, _)| name.clone());
    fonts.set_sans_serif_family(family.unwrap_or_default());
    // Letters that the first font lacks, such as some arrows and mathematical signs.
    fonts.load_font_data(epaint_default_fonts::HACK_REGULAR.to_vec());
    Arc::new(fonts)
}
