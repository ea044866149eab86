"""Plan files with a certificate: what was reviewed is what flies, and everything else is refused."""

import io
import json
import zipfile
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from swarm.certification.certificate import CertifiedPlan, certify
from swarm.errors import InputError, Refused
from swarm.front.plan_files import certified_plan_file, read_certified
from swarm.front.plans import Plan, load_plan
from swarm.planning import digest
from swarm.planning.archive import plan_file
from swarm.version import __version__
from tests.command import run
from tests.docs_reference import PLAN_FILE
from tests.network import sideways, uncleared

HOVER = str(Path(__file__).parents[1] / "missions" / "first-steps" / "hover.yaml")


@cache
def reviewed() -> CertifiedPlan:
    plan = sideways()
    return CertifiedPlan(plan, certify(plan, robustness=True))


@cache
def written() -> bytes:
    return certified_plan_file(reviewed())


def members(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def forged(name: str, change, **manifest: str | None) -> bytes:
    """Return the file with a changed document, and with a manifest that agrees with the change."""
    document = json.loads(members(written())[name])
    change(document)
    return repacked(name, json.dumps(document).encode(), **manifest)


def repacked(name: str, data: bytes, **manifest: str | None) -> bytes:
    """Return the file with another member, and with a manifest that agrees with it."""
    parts = members(written())
    parts[name] = data
    heading = json.loads(parts["manifest.json"]) | manifest
    heading["sha256"][name] = sha256(parts[name]).hexdigest()
    parts["manifest.json"] = json.dumps(heading).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for each, content in parts.items():
            archive.writestr(each, content)
    return buffer.getvalue()


def refusal(data: bytes) -> str:
    with pytest.raises(InputError) as error:
        read_certified(data, "a.plan")
    return str(error.value)


@pytest.mark.slow
def test_a_certified_plan_is_read_bit_by_bit_and_certified_again():
    again, notice = read_certified(written(), "a.plan")
    assert notice == ""
    assert digest(again.plan) == digest(reviewed().plan) == again.certificate.digest
    assert again.assessment.robustness == reviewed().assessment.robustness
    assert again.assessment.findings == reviewed().assessment.findings
    assert certified_plan_file(again.certified()) == written()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(digest="0" * 64), "expected that of this plan ("),
        (lambda d: d.update(kind="hop"), "got hop ("),
        (lambda d: d.update(kind="none"), "cannot be read: cable or kind is none of its values"),
        (lambda d: d.pop("findings"), "cannot be read: 'findings'"),
        (
            lambda d: d["robustness"].update(tracking=-1.0),
            "robustness.tracking: expected null or a number from 0 to 1, got -1.0",
        ),
        (
            lambda d: d.update(max_tracking_error=0.99),
            "max_tracking_error: expected ",
        ),
        (
            lambda d: d["robustness"].update(wind=15.1),
            "robustness.wind: expected null or a number from 0 to 15, got 15.1",
        ),
        (
            lambda d: d["robustness"].update(wind="calm"),
            "robustness.wind: expected null or a number from 0 to 15, got 'calm'",
        ),
    ],
)
def test_another_certificate_is_refused_although_its_digests_agree(change, words):
    said = refusal(forged("certificate.json", change))
    assert said.startswith("a.plan: certificate.json")
    assert words in said


@pytest.mark.slow
def test_an_edited_certificate_is_refused_with_every_figure_that_does_not_hold():
    flown = reviewed().assessment.distances["vehicle"].distance

    def change(document) -> None:
        document["cleared"] = False
        document["knot"]["type"] = "4_1"
        document["clearance"]["vehicle"]["distance"] += 0.1
        document["clearance"]["cable"]["required"] = 0.01
        document["robustness"].update(tracking=0.99)
        document["max_tracking_error"] = 0.99
        document["findings"].pop()
        document["findings"].append(dict(document["findings"][0], check="blessing"))

    place = "a.plan: certificate.json"
    assert refusal(forged("certificate.json", change)).splitlines() == [
        f"{place}: cleared: expected true, as computed again, got False",
        f"{place}: knot.type: expected 0_1, as computed again, got 4_1",
        f"{place}: clearance.cable.required: expected 0.15, as computed again, got 0.01",
        f"{place}: clearance.vehicle.distance: expected {flown:.4f}, as computed again, "
        f"got {flown + 0.1:.4f}",
        f"{place}: robustness.tracking: expected a value for which the plan is certified, got 0.99",
        f"{place}: findings: expected info scope, as computed again, got none",
        f"{place}: findings: got info blessing, which the checks do not find",
    ]


def stating_more(document) -> None:
    """Change a certificate so that it states more than the checks of its plan show."""
    document["clearance"]["vehicle"]["distance"] += 0.1
    document["robustness"].update(tracking=0.99)
    document["max_tracking_error"] = 0.99
    document["findings"].pop()


@pytest.mark.slow
def test_a_file_of_another_version_is_certified_anew_and_never_believed():
    shown = reviewed().assessment
    planned, notice = read_certified(
        forged("certificate.json", stating_more, checks="0123456789abcdef"), "a.plan"
    )
    assert planned.certificate.digest == digest(reviewed().plan)
    assert planned.assessment.robustness == shown.robustness
    assert planned.assessment.findings == shown.findings
    assert planned.assessment.distances == shown.distances
    vehicle = shown.distances["vehicle"].distance
    assert notice.splitlines() == [
        "a.plan: certified by another version of the program; all checks were computed again by "
        f"this one ({__version__}), and only their results count",
        f"  clearance.vehicle.distance: {vehicle:.4f} as computed again, "
        f"{vehicle + 0.1:.4f} in the file",
        f"  robustness.tracking: {shown.robustness.tracking:g} as computed again, 0.99 in the file",
        "  findings: info scope as computed again, none in the file",
    ]
    assert certified_plan_file(planned.certified()) == written()


@pytest.mark.slow
def test_a_file_of_another_version_with_the_same_figures_says_so(tmp_path):
    path = tmp_path / "a.plan"
    path.write_bytes(forged("certificate.json", lambda _: None, checks=None))
    said = run("plan", str(path), "--save", str(tmp_path / "b.plan"))
    assert said.returncode == 0
    assert said.stderr == (
        f"{path}: certified by another version of the program; all checks were computed again by "
        f"this one ({__version__}), and only their results count\n  no figure differs\n"
        f"{tmp_path / 'b.plan'}: saved; digest {digest(reviewed().plan)}\n"
    )
    assert (tmp_path / "b.plan").read_bytes() == written()


def test_a_file_of_another_version_is_refused_where_its_plan_is():
    refused = uncleared("clearance.vehicle=3.2").plan
    document = json.loads(members(written())["certificate.json"]) | {"digest": digest(refused)}
    data = plan_file(refused, document, "another version")
    errors = [each for each in certify(refused).findings if each.severity == "error"]
    assert refusal(data).splitlines() == [
        f"a.plan: certificate.json: {each.check}: {each.message}" for each in errors
    ]


def test_an_edited_plan_is_refused_although_its_digests_agree():
    plan = reviewed().plan
    clearance = plan.mission.clearance.model_copy(update={"vehicle": 2.99})
    strict = replace(plan, mission=plan.mission.model_copy(update={"clearance": clearance}))

    def change(document) -> None:
        document["mission"]["clearance"]["vehicle"] = 2.99

    data = forged("plan.json", change, digest=digest(strict))
    assert "expected that of this plan" in refusal(data)


def test_a_file_without_certificate_and_a_foreign_one_are_refused():
    assert refusal(plan_file(reviewed().plan)) == (
        "a.plan: expected a plan file with its certificate, as `swarm plan --save` writes it"
    )
    document = json.loads(members(written())["certificate.json"])
    other = sideways(height=6.0)
    assert f"a.plan: certificate.json: expected that of this plan ({digest(other)}), got" in (
        refusal(plan_file(other, document))
    )


def test_a_plan_that_its_checks_refuse_is_refused_whatever_its_certificate_states():
    refused = uncleared("clearance.vehicle=3.2").plan
    document = json.loads(members(written())["certificate.json"]) | {"digest": digest(refused)}
    errors = [one for one in certify(refused).findings if one.severity == "error"]
    assert errors
    assert refusal(plan_file(refused, document)).splitlines() == [
        f"a.plan: certificate.json: {one.check}: {one.message}" for one in errors
    ]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("lengths", [3.6], "1 segments between 3 vehicles"),
        ("sags", [0.5], "layout.sags: expected 2 finite numbers"),
        ("crossings", [[0, 7]], "layout.crossings: a segment that does not exist"),
    ],
)
def test_a_plan_that_is_not_of_one_team_is_refused(key, value, words):
    data = forged("plan.json", lambda document: document["layout"].update({key: value}))
    assert refusal(data) == f"a.plan: the plan cannot be read: {words}"


def test_plans_are_saved_from_python_with_their_certificate(tmp_path):
    certified = reviewed()
    plan = Plan.of(certified.plan)
    plan.save(tmp_path / "a.plan", certified.certificate)
    assert (tmp_path / "a.plan").read_bytes() == written()
    assert digest(load_plan(tmp_path / "a.plan")) == digest(plan)
    refused = uncleared("clearance.vehicle=3.2")
    with pytest.raises(Refused):
        Plan.of(refused.plan).save(tmp_path / "b.plan", refused.certificate)
    with pytest.raises(Refused, match="another plan"):
        Plan.of(refused.plan).save(tmp_path / "b.plan", certified.certificate)
    assert not (tmp_path / "b.plan").exists()


def test_commands_take_a_plan_file_as_a_mission(tmp_path):
    saved, again, flown = (str(tmp_path / name) for name in ("a.plan", "b.plan", "flown.rrd"))
    planned = run("plan", HOVER, "--json", "--save", saved)
    name = json.loads(members(Path(saved).read_bytes())["manifest.json"])["digest"]
    assert planned.returncode == 0
    assert planned.stderr == f"{saved}: saved; digest {name}\n"
    read = run("plan", saved, "--json", "--save", again)
    assert (read.returncode, read.stdout) == (0, planned.stdout)
    assert Path(saved).read_bytes() == Path(again).read_bytes()
    dry = run("dry-run", saved, "--json")
    assert (dry.returncode, dry.stdout) == (0, run("dry-run", HOVER, "--json").stdout)
    assert run("view", saved, "--output", flown).returncode == 0
    assert Path(flown).read_bytes().startswith(b"RRF")


@pytest.mark.parametrize("command", ["plan", "dry-run", "fly", "check", "view", "failures", "rope"])
def test_every_command_refuses_a_changed_plan_file(command, tmp_path):
    path = tmp_path / "a.plan"
    path.write_bytes(forged("certificate.json", lambda d: d.update(digest="0" * 64)))
    said = run(command, str(path))
    assert (said.returncode, said.stdout) == (2, "")
    assert said.stderr == (
        f"{path}: certificate.json: expected that of this plan ({digest(reviewed().plan)}), got "
        f"certified ({'0' * 64})\n"
    )


def test_options_that_change_a_plan_do_not_go_with_a_plan_file(tmp_path):
    path = tmp_path / "a.plan"
    path.write_bytes(written())
    said = run("fly", str(path), "--set", "vehicles.tracking=0.05", "--replan")
    assert (said.returncode, said.stdout) == (2, "")
    assert said.stderr == (
        f"--set: {path} is a plan file, which is not planned again\n"
        f"--replan: {path} is a plan file, which is not planned again\n"
    )
    missing = run("fly", "nosuch.plan")
    assert (missing.returncode, missing.stderr) == (2, "nosuch.plan: no such file or directory\n")


def test_a_refused_plan_is_not_saved(tmp_path):
    path = tmp_path / "a.plan"
    said = run("plan", HOVER, "--set", "workspace.ceiling=3.5", "--save", str(path), "--json")
    assert said.returncode == 1
    assert said.stderr == f"{path}: not written: the plan is refused\n"
    assert not path.exists()


def test_digits_of_floats_are_kept():
    plan = reviewed().plan
    coefficients = plan.motion.coefficients + np.spacing(plan.motion.coefficients)
    moved = replace(plan, motion=replace(plan.motion, coefficients=coefficients))
    assert digest(moved) != digest(plan)
    path = io.BytesIO(members(plan_file(moved))["motion.npz"])
    with np.load(path) as arrays:
        assert arrays["coefficients"].tobytes() == coefficients.tobytes()


def test_the_reference_names_every_member_and_key_of_a_plan_file():
    parts = members(written())
    assert parts.keys() == PLAN_FILE.keys()
    for name, keys in PLAN_FILE.items():
        data = io.BytesIO(parts[name])
        found = np.load(data).keys() if name.endswith(".npz") else json.load(data)
        assert list(found) == list(keys), name


def test_a_mission_of_another_version_is_refused_with_its_key():
    data = forged("plan.json", lambda document: document["mission"]["cable"].update(length=-3.0))
    assert refusal(data) == (
        "a.plan: the plan: mission: cable.length: expected a length > 0 in metres, got -3.0"
    )
