"""Threads that use scenes at the same time get the values of one thread alone."""

from concurrent.futures import ThreadPoolExecutor

import pytest

import polywigner.mitsuba as pm

pytestmark = [pytest.mark.drjit, pytest.mark.llvm]

SCENE = """
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <shape type="wigner">
        <string name="aperture" value="square.wkt"/>
        <string name="wavelength" value="3.2 mm"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world">
            <scale value="0.3"/><rotate x="1" angle="180"/><translate z="0.5"/>
        </transform>
    </shape>
    <sensor type="wigner_receiver">
        <string name="aperture" value="square.wkt"/>
        <string name="wavelength" value="3.2 mm"/>
        <transform name="to_world"><translate x="0.05"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="1"/><integer name="height" value="1"/>
            <rfilter type="box"/>
        </film>
    </sensor>
</scene>
"""
RUNS = 25
# Kernels add in single precision, in an order that depends on the scenes that are alive.
ROUNDING = 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("threads", [2, 4])
def test_threads_that_load_and_receive_at_once_get_the_power_of_one(tmp_path, threads):
    (tmp_path / "square.wkt").write_text("POLYGON ((0 0, 5 0, 5 5, 0 5, 0 0))")
    (tmp_path / "scene.xml").write_text(SCENE)

    def power(_):
        scene = pm.load_scene(tmp_path / "scene.xml", "llvm_ad_mono")
        return float(pm.received_power(scene, spp=1 << 7, seed=1).power)

    alone = power(0)
    assert alone > 0
    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(power, range(RUNS)))
    assert found == pytest.approx([alone] * RUNS, rel=ROUNDING)
