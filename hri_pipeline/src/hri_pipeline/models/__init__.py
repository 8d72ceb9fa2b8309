"""Getting the models: which ones there are, where they come from, and how they become ONNX files.

`catalogue` reads the pinned table models.yaml, `packages` gets the package files, `convert` and the `..._to_onnx`
modules make models of their members, `fetch` puts them in place, `__main__` is the command line.
"""
