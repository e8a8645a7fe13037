"""The answer on a machine whose joints follow targets: searched in closed loop, reported, written
to files, and these run beside the declared one.
"""

from adaptsim_jax.attribution import closed_loop, servo_files
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import WHOLE
from adaptsim_jax.attribution.posed import DiagnosisSetting
from adaptsim_jax.attribution.servo_numbers import number_rows
from adaptsim_jax.core.progress import Note
from adaptsim_jax.diagnosis.written import Answer, DiagnosisRequest, write_partial


def answered(
    machine: Machine, setting: DiagnosisSetting, asked: DiagnosisRequest, notify: Note
) -> Answer | None:
    """What the closed loop of a machine's servos shows; None where it has none, where another
    yardstick or other effects were asked for, and where stretches can show more.
    """
    if setting.objective not in (None, WHOLE) or setting.effects is not None:
        return None
    few = setting.criteria.torque.simulated

    def keep(found: closed_loop.ServoDiagnosis) -> None:
        if asked.folder is not None:
            write_partial(asked.folder, lambda: closed_loop.report_on(found))

    found = closed_loop.diagnosed(machine, setting.exclude, few, notify, keep)
    if found is None:
        return None
    report, evidence = closed_loop.reported(found)
    files, verify = servo_files.files(found, asked.made), servo_files.verifier(found)
    return Answer(report, evidence, files, verify, number_rows(found))
