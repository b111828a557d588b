"""Checks zephyr/module.yml of a module as Zephyr's scripts/zephyr_module.py does: module.py MODULE"""
import pathlib
import sys

import yaml

BUILD = {"cmake", "kconfig", "cmake-ext", "kconfig-ext", "depends", "settings"}
TOP = {"name", "build", "tests", "samples", "boards", "blobs"}


def main(module):
    module = pathlib.Path(module)
    meta = yaml.safe_load((module / "zephyr/module.yml").read_text())
    for keys, known in ((meta, TOP), (meta["build"], BUILD)):
        if unknown := set(keys) - known:
            sys.exit(f"module.yml: Zephyr knows no {', '.join(sorted(unknown))}")
    wanted = [module / meta["build"]["cmake"] / "CMakeLists.txt", module / meta["build"]["kconfig"]]
    samples = []
    for folder in meta["samples"]:
        samples += sorted((module / folder).glob("**/sample.yaml"))
    for sample in samples:
        wanted += [sample.parent / name for name in ("CMakeLists.txt", "prj.conf", "README.md", "src/main.c")]
        described = yaml.safe_load(sample.read_text())
        if set(described) != {"sample", "tests"} or not all(name.startswith("sample.") for name in described["tests"]):
            sys.exit(f"{sample}: twister wants sample and tests, whose names begin with sample.")
    if missing := [str(path) for path in wanted if not path.is_file()]:
        sys.exit(f"module.yml leads to {', '.join(missing)}, which are not there")
    if not samples:
        sys.exit("module.yml: no sample.yaml below samples")
    print(f"Zephyr: module.yml of {meta['name']} leads to what is there, with {len(samples)} sample")


main(*sys.argv[1:])
