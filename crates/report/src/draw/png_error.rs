//! The error of drawing a PNG, which exists in builds without the feature `png`, too.

/// Maximum number of pixels of a picture, which take 64 MiB.
#[cfg(feature = "png")]
pub(super) const MAX_PIXELS: f64 = 16_777_216.0;

/// An error of drawing a PNG.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DrawError {
    /// This build draws no PNG ([`WRITES_PNG`](super::WRITES_PNG)).
    #[error("figures as PNG files need a build with the feature `png`")]
    NeedsPng,
    /// The SVG could not be read back.
    #[cfg(feature = "png")]
    #[error("the figure is not valid SVG: {0}")]
    Svg(#[from] resvg::usvg::Error),
    /// The picture would be empty or too large.
    #[cfg(feature = "png")]
    #[error(
        "the picture has {width} by {height} pixels, and a PNG may have 1 to {limit}: write an SVG",
        limit = MAX_PIXELS
    )]
    Size {
        /// Width in pixels.
        width: f64,
        /// Height in pixels.
        height: f64,
    },
    /// The pixels could not be compressed.
    #[cfg(feature = "png")]
    #[error("cannot encode the picture as PNG: {0}")]
    Encode(String),
}
