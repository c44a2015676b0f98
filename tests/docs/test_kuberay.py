"""The manifest of docs/scale.md has the fields and types of KubeRay's RayJob, version ray.io/v1.

The schema holds the part of Ray, from the types of KubeRay (ray-operator/apis/ray/v1), and what the
manifest uses of a Kubernetes pod; unknown fields are errors, as `kubectl apply` treats them.
"""

import re
from pathlib import Path

import jsonschema
import pytest
import yaml

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scale.md"
TEXT, COUNT = {"type": "string"}, {"type": "integer", "minimum": 0}
TEXTS = {"type": "object", "additionalProperties": TEXT}


def struct(required=(), **fields):
    """Schema of an object without other fields."""
    return {
        "type": "object",
        "properties": fields,
        "required": list(required),
        "additionalProperties": False,
    }


def many(item):
    """Schema of a list."""
    return {"type": "array", "items": item}


CONTAINER = struct(
    ["name", "image"],
    name=TEXT,
    image=TEXT,
    resources=struct(limits=TEXTS, requests=TEXTS),
    volumeMounts=many(struct(["name", "mountPath"], name=TEXT, mountPath=TEXT)),
)
VOLUME = struct(["name"], name=TEXT, persistentVolumeClaim=struct(["claimName"], claimName=TEXT))
POD = struct(
    ["spec"], spec=struct(["containers"], containers=many(CONTAINER), volumes=many(VOLUME))
)
HEAD = struct(["rayStartParams", "template"], rayStartParams=TEXTS, template=POD)
GROUP = struct(
    ["groupName", "minReplicas", "maxReplicas", "rayStartParams", "template"],
    groupName=TEXT,
    replicas=COUNT,
    minReplicas=COUNT,
    maxReplicas=COUNT,
    rayStartParams=TEXTS,
    template=POD,
)
CLUSTER = struct(["headGroupSpec"], headGroupSpec=HEAD, workerGroupSpecs=many(GROUP))
JOB = struct(entrypoint=TEXT, shutdownAfterJobFinishes={"type": "boolean"}, rayClusterSpec=CLUSTER)
SCHEMA = struct(
    ["apiVersion", "kind", "metadata", "spec"],
    apiVersion={"const": "ray.io/v1"},
    kind={"const": "RayJob"},
    metadata=struct(["name"], name=TEXT),
    spec=JOB,
)


@pytest.fixture
def manifest():
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (found,) = (block for block in blocks if "kind: RayJob" in block)
    return yaml.safe_load(found)


def test_the_manifest_fits_the_schema(manifest):
    jsonschema.validate(manifest, SCHEMA)
    cluster = manifest["spec"]["rayClusterSpec"]
    for group in [cluster["headGroupSpec"], *cluster["workerGroupSpecs"]]:
        pod = group["template"]["spec"]
        mounted = {mount["name"] for one in pod["containers"] for mount in one["volumeMounts"]}
        assert mounted == {volume["name"] for volume in pod["volumes"]}


def test_a_misspelt_field_or_a_number_for_a_text_is_noticed(manifest):
    cluster = manifest["spec"]["rayClusterSpec"]
    cluster["headGroupSpec"]["rayStartParams"]["num-cpus"] = 0
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(manifest, SCHEMA)
    cluster["headGroupSpec"]["rayStartParams"]["num-cpus"] = "0"
    cluster["workerGroupSpecs"][0]["replica"] = 1
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(manifest, SCHEMA)
