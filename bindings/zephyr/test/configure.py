"""Writes a .config as Zephyr's scripts/kconfig/kconfig.py does: configure.py KCONFIG OUT FILE...

Each FILE holds lines CONFIG_X=value. A value that Kconfig does not take is an error, as it is in Zephyr.
"""
import sys

import kconfiglib


def main(kconfig_file, out, *files):
    kconfig = kconfiglib.Kconfig(kconfig_file, warn_to_stderr=False)
    for number, file in enumerate(files):
        kconfig.load_config(file, replace=number == 0)
    wrong = list(kconfig.warnings)
    for symbol in kconfig.unique_defined_syms:
        given = symbol.user_value
        if given is None:
            continue
        given = kconfiglib.TRI_TO_STR[given] if isinstance(given, int) else given
        if given != symbol.str_value:
            wrong.append(
                f"CONFIG_{symbol.name}={given} was asked for and {symbol.str_value!r} came out: see its dependencies"
            )
    if wrong:
        sys.exit("\n".join(wrong))
    kconfig.write_config(out)


main(*sys.argv[1:])
