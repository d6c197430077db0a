"""Prints ``MIXED_LM`` of tests/nested_designs.py: the same designs fitted by statsmodels' MixedLM (installed by hand)."""

import sys
import warnings
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))
from nested_designs import nested_design


def main() -> None:
    import statsmodels.formula.api as smf

    warnings.simplefilter("ignore")
    for seed in range(50):
        data = pd.DataFrame(nested_design(seed), columns=["lot", "wafer", "y"])
        model = smf.mixedlm("y~1", data, groups="lot", re_formula="1", vc_formula={"wafer": "0+C(wafer)"})
        fits = [
            model.fit(reml=True, method="lbfgs", gtol=1e-10),
            model.fit(reml=True, method="bfgs", gtol=1e-10),
            model.fit(reml=True, method="powell", xtol=1e-10, ftol=1e-14),
        ]
        best = max(fits, key=lambda fit: fit.llf)
        variances = (best.cov_re.iloc[0, 0], best.vcomp[0], best.scale)
        sds = ", ".join(f"{max(v, 0.0) ** 0.5:.7f}" for v in variances)
        print(f"    {seed}: ({sds}, {best.llf:.6f}),")


if __name__ == "__main__":
    main()
