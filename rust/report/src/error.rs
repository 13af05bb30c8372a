//! What can go wrong with images.

/// An error of comparing images.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Images that are compared have different sizes.
    #[error("the images have {} × {} and {} × {} pixels; only images of one size can be compared", .0[0], .0[1], .1[0], .1[1])]
    Sizes([usize; 2], [usize; 2]),
    /// An environment that lights nothing.
    #[error("{0} is black; expected an environment map with light in it")]
    Dark(String),
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] glimt_image::Error),
}
