//! The same update, stated plainly on candle's tensors and automatic differentiation.
