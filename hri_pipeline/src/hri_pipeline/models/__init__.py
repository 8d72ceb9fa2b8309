"""Getting the models: which ones there are, where they come from, and how they become ONNX files.

`catalogue` is the pinned table, `packages` gets the packages, the three `..._to_onnx` modules convert,
`fetch` drives all of it, `names` holds the file and tensor names that the loading side uses too.
"""
