"""Videos that drive rendering by Diffusion as Shader, from scene files: `python -m rigidformer_lab.controls --help`.

Needs NumPy, SciPy, safetensors, tqdm and PyAV, and no PyTorch. Predictions need the package `rigidformer` too.
"""
