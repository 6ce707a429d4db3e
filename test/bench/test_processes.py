"""Runs beside each other, in processes of one thread."""

import os

import pytest

from tissue_sim.bench.processes import on_all_cores

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@pytest.mark.extended
def test_results_come_in_the_order_of_the_runs_and_each_has_its_fraction_of_the_cores():
    runs = [(number, 7) for number in range(20)]
    assert list(on_all_cores(divmod, runs)) == [divmod(*run) for run in runs]
    cores = os.cpu_count() or 1
    found = list(on_all_cores(os.getenv, [(name,) for name in THREADS for _ in range(cores)]))
    assert found == ["1"] * len(THREADS) * cores or cores == 1


def test_nothing_to_run_takes_no_process():
    assert list(on_all_cores(divmod, [])) == []


@pytest.mark.extended
def test_an_error_of_a_run_is_raised():
    with pytest.raises(ZeroDivisionError):
        list(on_all_cores(divmod, [(1, 1), (1, 0)]))
