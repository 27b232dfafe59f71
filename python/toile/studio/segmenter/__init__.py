"""The network that labels pictures of people where a capture has no label images: `python -m toile.studio.segmenter.train`
makes `assets/clothes.onnx` from renders alone. `people` dresses and poses bodies, `views` renders what is fixed about them,
`looks` draws their colours, light and backgrounds anew each time, `network` is what is trained."""

CLASSES = ("background", "skin", "hair", "top", "bottom", "dress", "shoes")
