#!/usr/bin/env python3
"""What deploy/ promises, read from its files: they run everywhere, without an engine or a cluster.

Each rule is a function from parsed files to complaints. The files as they are must have none; for each rule there is a planted
fault that it must find. Usage: manifests_test.py PROJECT_ROOT PROGRAMS_DIR
"""
import copy
import functools
import json
import pathlib
import re
import subprocess
import sys
import unittest

import jsonschema
import yaml

ROOT = pathlib.Path(sys.argv[1])
PROGRAMS = pathlib.Path(sys.argv[2])
DEPLOY = ROOT / "deploy"
SCHEMAS = json.loads((ROOT / "tests/deploy/schemas.json").read_text())


def by_path(errors):
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message}" for error in errors]


@functools.cache
def help_words(program):
    """The options that a program answers to."""
    text = subprocess.run([PROGRAMS / program, "--help"], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"--[a-z-]+", text))


def option_complaints(where, words):
    """Words of a command line: a program of ours, then its options."""
    words = [word for word in words if word]
    if not words or not words[0].rsplit("/", 1)[-1].startswith("gleaner"):
        return [f"{where}: expected one of the farm's programs, found {words[:1]}"]
    known = help_words(words[0].rsplit("/", 1)[-1])
    options = [word.split("=")[0] for word in words[1:] if word.startswith("--")]
    return [f"{where}: {words[0]} has no option {option}" for option in options if option not in known]


# ------------------------------------------------------------------------------------------------ docker compose


def read_compose(file="docker-compose.yml"):
    text = (DEPLOY / file).read_text()
    text = re.sub(r"\$\{[A-Z_]+:-([^}]*)\}", r"\1", text)
    if "${" in text:
        raise ValueError(f"{file}: expected a default for every variable")
    return yaml.safe_load(text)


def merged(below, above):
    """As docker compose and kustomize do it: maps by key, lists of named things by name, other lists one behind the other."""
    if isinstance(below, dict) and isinstance(above, dict):
        both = dict(below)
        for key, value in above.items():
            if value is None:  # what it names is taken out; a volume without options is named by itself
                both = {name: one for name, one in both.items() if name != key} if both.get(key) else {**both, key: None}
            else:
                both[key] = merged(both[key], value) if key in both else value
        return both
    if isinstance(below, list) and isinstance(above, list):
        if not all(isinstance(one, dict) and "name" in one for one in below + above):
            return below + above
        names = {one["name"]: one for one in below}
        for one in above:
            names[one["name"]] = merged(names.get(one["name"], {}), one)
        return list(names.values())
    return above


def read_compose_with_keys():
    return merged(read_compose(), read_compose("docker-compose.keys.yml"))


def compose_keys_complaints(compose):
    """Each part gets its own keys and no others; the authority's stay with who makes them."""
    found = compose_complaints(compose)
    services = compose["services"]
    mounts = {name: [volume.split(":") for volume in service["volumes"]] for name, service in services.items()}
    for name, volume in (("coordinator", "coordinator-keys"), ("worker", "worker-keys"), ("gleaner", "person-keys")):
        if services[name].get("environment", {}).get("GLEANER_KEYS") != "/keys":
            found.append(f"{name}: expected GLEANER_KEYS")
        if [mount for mount in mounts[name] if mount[1] == "/keys"] != [[volume, "/keys", "ro"]]:
            found.append(f"{name}: expected {volume} at /keys, read-only")
        if any(mount[0] == "authority" for mount in mounts[name]):
            found.append(f"{name}: the authority's key is open to it")
    if services["coordinator"]["depends_on"].get("keys", {}).get("condition") != "service_completed_successfully":
        found.append("coordinator: starts before there are keys")
    if services["keys"].get("network_mode") != "none":
        found.append("keys: needs no network")
    return found


def compose_complaints(compose):
    found = by_path(jsonschema.Draft7Validator(SCHEMAS["compose"]).iter_errors(compose))
    if found:
        return found
    services = compose["services"]
    for name, service in services.items():
        for key, expected in (
            ("read_only", True),
            ("cap_drop", ["ALL"]),
            ("security_opt", ["no-new-privileges:true"]),
        ):
            if service.get(key) != expected:
                found.append(f"{name}.{key}: expected {expected}, found {service.get(key)}")
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            if not source.startswith((".", "/")) and source not in compose["volumes"]:
                found.append(f"{name}.volumes: {source} is not declared")
        if not any(mount.startswith("/tmp:size=") for mount in service.get("tmpfs", [])):
            found.append(f"{name}.tmpfs: expected a bounded /tmp")
        for port in service.get("ports", []):
            if not port.startswith("127.0.0.1:"):
                found.append(f"{name}.ports: {port} is open to other machines")
    for name in ("coordinator", "worker"):
        service = services[name]
        for key in ("mem_limit", "pids_limit", "cpus", "stop_grace_period", "restart", "logging"):
            if key not in service:
                found.append(f"{name}: expected {key}")
        found += option_complaints(f"{name}.command", service["command"].split())
    coordinator, worker = services["coordinator"], services["worker"]
    if "test" not in coordinator.get("healthcheck", {}):
        found.append("coordinator: expected a healthcheck")
    else:
        found += option_complaints("coordinator.healthcheck", coordinator["healthcheck"]["test"][1:])
    if not any(volume.endswith(":/data") for volume in coordinator.get("volumes", [])):
        found.append("coordinator.volumes: expected one for /data")
    if worker.get("depends_on", {}).get("coordinator", {}).get("condition") != "service_healthy":
        found.append("worker.depends_on: expected a healthy coordinator")
    for key in ("container_name", "hostname", "ports"):
        if key in worker:
            found.append(f"worker.{key}: then --scale has no effect")
    dockerfile = coordinator.get("build", {}).get("dockerfile", "")
    if not (ROOT / dockerfile).is_file():
        found.append(f"coordinator.build: no file {dockerfile}")
    return found


# ------------------------------------------------------------------------------------------------ Kubernetes


def read_kubernetes():
    objects = []
    for file in yaml.safe_load((DEPLOY / "kubernetes/kustomization.yaml").read_text())["resources"]:
        objects += [one for one in yaml.safe_load_all((DEPLOY / "kubernetes" / file).read_text())]
    return objects


def read_kubernetes_with_keys():
    folder = DEPLOY / "kubernetes-keys"
    objects = {(one["kind"], one["metadata"]["name"]): one for one in read_kubernetes()}
    overlay = yaml.safe_load((folder / "kustomization.yaml").read_text())
    if overlay["resources"] != ["../kubernetes"]:
        raise ValueError(f"kubernetes-keys: expected it to begin with ../kubernetes, found {overlay['resources']}")
    for patch in overlay["patches"]:
        above = yaml.safe_load((folder / patch["path"]).read_text())
        name = (above["kind"], above["metadata"]["name"])
        objects[name] = merged(objects[name], above)
    return list(objects.values())


def kubernetes_keys_complaints(objects):
    found = kubernetes_complaints(objects)
    for one in objects:
        if one["kind"] not in ("Deployment", "StatefulSet"):
            continue
        name = one["metadata"]["name"]
        pod = one["spec"]["template"]["spec"]
        container = pod["containers"][0]
        if {"name": "GLEANER_KEYS", "value": "/keys"} not in container.get("env", []):
            found.append(f"{name}: expected GLEANER_KEYS")
        if {"name": "keys", "mountPath": "/keys", "readOnly": True} not in container["volumeMounts"]:
            found.append(f"{name}: expected keys at /keys, read-only")
        secrets = [volume["secret"]["secretName"] for volume in pod["volumes"] if "secret" in volume]
        if secrets != [f"{name}-keys"]:
            found.append(f"{name}: expected the secret {name}-keys alone, found {secrets}")
        if "grpc" in container.get("readinessProbe", {}):
            found.append(f"{name}: the kubelet has no certificate to call it with")
    return found


def schema_complaints(objects):
    found = []
    for one in objects:
        kind = f"{one.get('apiVersion')}/{one.get('kind')}"
        name = f"{one.get('kind')} {one.get('metadata', {}).get('name')}"
        if kind not in SCHEMAS["kinds"]:
            found.append(f"{name}: {kind} is not among the kinds of tests/deploy/make_schemas.py")
            continue
        schema = {"$ref": "#/$defs/" + SCHEMAS["kinds"][kind], "$defs": SCHEMAS["kubernetes"]["$defs"]}
        found += [f"{name}: {text}" for text in by_path(jsonschema.Draft7Validator(schema).iter_errors(one))]
    return found


def pod_complaints(name, template, claims):
    found = []
    pod = template["spec"]
    if not pod.get("securityContext", {}).get("runAsNonRoot"):
        found.append(f"{name}: expected runAsNonRoot")
    user = re.search(r"^USER (\d+):(\d+)$", (DEPLOY / "Dockerfile").read_text(), re.M)
    if pod["securityContext"].get("runAsUser") != int(user[1]):
        found.append(f"{name}: runAsUser: expected the image's {user[1]}")
    if "terminationGracePeriodSeconds" not in pod:
        found.append(f"{name}: expected a grace time for the batch that runs")
    volumes = {volume["name"] for volume in pod.get("volumes", [])} | claims
    for container in pod["containers"]:
        where = f"{name}.{container['name']}"
        found += option_complaints(where, container["args"])
        context = container.get("securityContext", {})
        if not context.get("readOnlyRootFilesystem") or context.get("allowPrivilegeEscalation") is not False:
            found.append(f"{where}: expected a read-only root and no privilege escalation")
        if "memory" not in container.get("resources", {}).get("limits", {}):
            found.append(f"{where}: expected a limit of memory")
        for mount in container.get("volumeMounts", []):
            if mount["name"] not in volumes:
                found.append(f"{where}: no volume {mount['name']}")
        ports = {port["name"]: port["containerPort"] for port in container.get("ports", [])}
        listened = {int(number) for number in re.findall(r":(\d+)(?:\s|$)", " ".join(container["args"]))}
        for port_name, number in ports.items():
            if number not in listened:
                found.append(f"{where}: port {port_name}: nothing listens on {number}")
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            asked = container.get(probe, {})
            port = asked.get("httpGet", {}).get("port", asked.get("grpc", {}).get("port"))
            if asked and port not in ports and port not in ports.values():
                found.append(f"{where}.{probe}: no port {port}")
    return found


def kubernetes_complaints(objects):
    found = schema_complaints(objects)
    if found:
        return found
    named = {(one["kind"], one["metadata"]["name"]): one for one in objects}
    pods = {}
    for (kind, name), one in named.items():
        if kind != "Namespace" and one["metadata"].get("namespace") != "gleaner":
            found.append(f"{kind} {name}: expected the namespace gleaner")
        if kind in ("Deployment", "StatefulSet"):
            template = one["spec"]["template"]
            pods[name] = template
            claims = {claim["metadata"]["name"] for claim in one["spec"].get("volumeClaimTemplates", [])}
            if one["spec"]["selector"]["matchLabels"] != template["metadata"]["labels"]:
                found.append(f"{kind} {name}: its selector does not match its pods' labels")
            found += pod_complaints(f"{kind} {name}", template, claims)
    for (kind, name), one in named.items():
        selector = None
        if kind == "Service":
            selector = one["spec"]["selector"]
        if kind == "NetworkPolicy":
            selector = one["spec"]["podSelector"]["matchLabels"]
        if selector is not None and selector not in [pod["metadata"]["labels"] for pod in pods.values()]:
            found.append(f"{kind} {name}: selects no pod")
        if kind == "StatefulSet" and ("Service", one["spec"]["serviceName"]) not in named:
            found.append(f"StatefulSet {name}: no service {one['spec']['serviceName']}")
        if kind == "HorizontalPodAutoscaler":
            target = one["spec"]["scaleTargetRef"]
            if (target["kind"], target["name"]) not in named:
                found.append(f"{kind} {name}: no {target['kind']} {target['name']}")
            elif "replicas" in named[target["kind"], target["name"]]["spec"]:
                found.append(f"{kind} {name}: its target has a count of its own")
            page = (ROOT / "coordinator/gateway/metrics_page.cpp").read_text()
            for metric in one["spec"]["metrics"]:
                if f'"{metric["external"]["metric"]["name"]}"' not in page:
                    found.append(f"{kind} {name}: the coordinator has no metric {metric['external']['metric']['name']}")
    called = [arg for arg in pods["worker"]["spec"]["containers"][0]["args"] if arg.startswith("--coordinator=")]
    host, _, port = called[0].split("=")[1].partition(":") if called else ("", "", "0")
    service = named.get(("Service", host))
    if service is None or int(port) not in [one["port"] for one in service["spec"]["ports"]]:
        found.append(f"Deployment worker: calls {host}:{port}, which no service answers")
    return found


# ------------------------------------------------------------------------------------------------ Slurm, systemd, the image


def read_commands():
    """Command lines of the Slurm script and the systemd units, by where they stand."""
    commands = {}
    for line in (DEPLOY / "slurm/workers.sbatch").read_text().splitlines():
        if line.startswith('"$bin/'):
            commands["workers.sbatch"] = line.replace('"', "").rstrip("& ").split()
    for unit in sorted((DEPLOY / "systemd").glob("*.service")):
        for line in unit.read_text().splitlines():
            if line.startswith("ExecStart="):
                commands[unit.name] = line.partition("=")[2].split()
    return commands


def command_complaints(commands):
    found = [] if len(commands) == 3 else [f"expected three command lines, found {sorted(commands)}"]
    for where, words in commands.items():
        found += option_complaints(where, words)
    return found


def read_image():
    return {
        "dockerfile": (DEPLOY / "Dockerfile").read_text(),
        "ignore": (DEPLOY / "Dockerfile.dockerignore").read_text().splitlines(),
        "rooms": re.search(r"set\(rooms (scene [^)]*proto[^)]*)\)", (ROOT / "CMakeLists.txt").read_text())[1].split(),
    }


def image_complaints(image):
    found = []
    for room in image["rooms"]:
        if room != "bench" and f"!{room}" not in image["ignore"]:
            found.append(f"Dockerfile.dockerignore: the build needs {room}/")
    for path in ("CMakeLists.txt", "cmake"):
        if f"!{path}" not in image["ignore"]:
            found.append(f"Dockerfile.dockerignore: the build needs {path}")
    if image["ignore"][1:2] != ["*"]:
        found.append("Dockerfile.dockerignore: expected to leave out all that it does not name")
    stages = re.split(r"^FROM ", image["dockerfile"], flags=re.M)
    if not re.search(r"^USER [1-9]\d*:[1-9]\d*$", stages[-1], re.M):
        found.append("Dockerfile: expected a numeric USER that is not root")
    if "packages-debian12.txt" in stages[-1].replace("packages-runtime-debian12.txt", ""):
        found.append("Dockerfile: the image installs the compilers")
    return found


# ------------------------------------------------------------------------------------------------ tests


def at(node, path):
    for key in path:
        node = node[key]
    return node


def put(*path_and_value):
    *path, key, value = path_and_value
    return lambda node: at(node, path).__setitem__(key, value)


def drop(*path):
    *path, key = path
    return lambda node: at(node, path).__delitem__(key)


class Manifests(unittest.TestCase):
    def check(self, read, complaints, faults):
        """No complaint about the files; for each fault, one that holds the words beside it."""
        self.assertEqual(complaints(read()), [])
        for plant, words in faults:
            broken = copy.deepcopy(read())
            plant(broken)
            found = complaints(broken)
            self.assertTrue(any(words in text for text in found), f"expected '{words}', found {found}")

    def test_compose(self):
        services = ("services",)
        self.check(
            read_compose,
            compose_complaints,
            [
                (put(*services, "worker", "memory_limit", "1g"), "memory_limit"),
                (put(*services, "worker", "cap_add", "SYS_ADMIN"), "SYS_ADMIN"),
                (put(*services, "worker", "read_only", False), "worker.read_only"),
                (drop(*services, "gleaner", "cap_drop"), "gleaner.cap_drop"),
                (drop(*services, "worker", "security_opt"), "worker.security_opt"),
                (drop(*services, "worker", "tmpfs"), "worker.tmpfs"),
                (put(*services, "worker", "volumes", ["nowhere:/cache"]), "nowhere is not declared"),
                (put(*services, "coordinator", "ports", ["8780:8780"]), "open to other machines"),
                (drop(*services, "worker", "mem_limit"), "expected mem_limit"),
                (drop(*services, "coordinator", "restart"), "expected restart"),
                (drop(*services, "worker", "stop_grace_period"), "expected stop_grace_period"),
                (drop(*services, "coordinator", "healthcheck"), "expected a healthcheck"),
                (put(*services, "coordinator", "healthcheck", "test", ["CMD", "curl", "x"]), "the farm's programs"),
                (put(*services, "worker", "command", "gleaner-worker --cordinator x"), "no option --cordinator"),
                (put(*services, "coordinator", "volumes", ["data:/dta"]), "expected one for /data"),
                (put(*services, "worker", "depends_on", {"coordinator": {"condition": "service_started"}}), "expected a healthy coordinator"),
                (put(*services, "worker", "container_name", "worker"), "--scale"),
                (put(*services, "coordinator", "build", "dockerfile", "Dockerfile"), "no file Dockerfile"),
            ],
        )

    def test_compose_with_keys(self):
        services = ("services",)
        self.check(
            read_compose_with_keys,
            compose_keys_complaints,
            [
                (put(*services, "keys", "read_only", False), "keys.read_only"),
                (drop(*services, "worker", "environment", "GLEANER_KEYS"), "worker: expected GLEANER_KEYS"),
                (put(*services, "worker", "volumes", ["coordinator-keys:/keys:ro"]), "expected worker-keys at /keys"),
                (put(*services, "gleaner", "volumes", ["person-keys:/keys:ro", "authority:/a"]), "the authority's key is open"),
                (drop(*services, "coordinator", "depends_on", "keys"), "starts before there are keys"),
                (drop(*services, "keys", "network_mode"), "needs no network"),
                (drop("volumes", "person-keys"), "person-keys is not declared"),
            ],
        )

    def test_kubernetes_with_keys(self):
        index = {(one["kind"], one["metadata"]["name"]): i for i, one in enumerate(read_kubernetes_with_keys())}
        worker = (index["Deployment", "worker"], "spec", "template", "spec")
        coordinator = (index["StatefulSet", "coordinator"], "spec", "template", "spec")
        self.check(
            read_kubernetes_with_keys,
            kubernetes_keys_complaints,
            [
                (drop(*worker, "containers", 0, "env"), "worker: expected GLEANER_KEYS"),
                (put(*coordinator, "containers", 0, "volumeMounts", [{"name": "data", "mountPath": "/data"}]), "coordinator: expected keys at /keys"),
                (put(*worker, "volumes", [{"name": "keys", "secret": {"secretName": "coordinator-keys"}}]), "worker: expected the secret"),
                (put(*coordinator, "containers", 0, "readinessProbe", {"grpc": {"port": 8780}}), "the kubelet has no certificate"),
            ],
        )

    def test_kubernetes(self):
        index = {(one["kind"], one["metadata"]["name"]): i for i, one in enumerate(read_kubernetes())}
        worker = (index["Deployment", "worker"], "spec")
        worker_pod = (*worker, "template", "spec")
        worker_container = (*worker_pod, "containers", 0)
        coordinator = (index["StatefulSet", "coordinator"], "spec")
        coordinator_container = (*coordinator, "template", "spec", "containers", 0)
        autoscaler = (index["HorizontalPodAutoscaler", "worker"], "spec")
        self.check(
            read_kubernetes,
            kubernetes_complaints,
            [
                (put(*worker_pod, "terminationGracePeriod", 5), "terminationGracePeriod"),
                (put(*worker, "replicas", "three"), "three"),
                (put(*autoscaler, "maxReplica", 3), "maxReplica"),
                (drop(*coordinator, "selector"), "selector"),
                (put(index["Namespace", "gleaner"], "kind", "NameSpace"), "not among the kinds"),
                (put(index["Service", "coordinator"], "metadata", "namespace", "default"), "expected the namespace"),
                (put(*worker, "template", "metadata", "labels", {"a": "b"}), "its selector does not match"),
                (put(*worker_pod, "securityContext", "runAsNonRoot", False), "runAsNonRoot"),
                (put(*worker_pod, "securityContext", "runAsUser", 1000), "the image's"),
                (drop(*worker_pod, "terminationGracePeriodSeconds"), "grace time"),
                (put(*worker_container, "securityContext", "readOnlyRootFilesystem", False), "read-only root"),
                (drop(*worker_container, "resources", "limits", "memory"), "limit of memory"),
                (put(*worker_container, "volumeMounts", 0, "name", "nowhere"), "no volume nowhere"),
                (put(*worker_container, "args", 3, "--thread=2"), "no option --thread"),
                (put(*worker_container, "args", 1, "--coordinator=farm:8780"), "which no service answers"),
                (put(*coordinator_container, "args", 2, "--http=0.0.0.0:81"), "nothing listens on 8781"),
                (put(*coordinator_container, "livenessProbe", "httpGet", "port", "web"), "no port web"),
                (put(index["Service", "coordinator"], "spec", "selector", {"a": "b"}), "selects no pod"),
                (put(index["NetworkPolicy", "worker"], "spec", "podSelector", "matchLabels", {"a": "b"}), "selects no"),
                (put(*coordinator, "serviceName", "farm"), "no service farm"),
                (put(*autoscaler, "scaleTargetRef", "name", "wrkr"), "no Deployment wrkr"),
                (put(*worker, "replicas", 3), "a count of its own"),
                (put(*autoscaler, "metrics", 0, "external", "metric", "name", "frames"), "no metric frames"),
            ],
        )

    def test_commands_of_slurm_and_systemd(self):
        self.check(
            read_commands,
            command_complaints,
            [
                (drop("workers.sbatch"), "expected three command lines"),
                (put("workers.sbatch", ["$bin/gleaner-worker", "--nom", "x"]), "no option --nom"),
                (put("gleaner-worker@.service", ["/usr/bin/sleep", "1"]), "expected one of the farm's programs"),
            ],
        )

    def test_image(self):
        self.check(
            read_image,
            image_complaints,
            [
                (lambda image: image["rooms"].append("attic"), "needs attic/"),
                (lambda image: image["ignore"].remove("!cmake"), "needs cmake"),
                (lambda image: image["ignore"].remove("*"), "leave out"),
                (lambda image: image.update(dockerfile=image["dockerfile"].replace("USER 10001:10001", "")), "USER"),
                (lambda image: image.update(dockerfile=image["dockerfile"].replace("-runtime", "")), "compilers"),
            ],
        )


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0]], verbosity=2)
