import shutil,json
from pathlib import Path
from lpvguard.base import artefacts
from lpvguard.identify import run as identification
from lpvguard.vehicle.project import load_project
src,dst=Path('/tmp/truck/found'),Path('/tmp/truck/found56')
shutil.rmtree(dst,ignore_errors=True); shutil.copytree(src,dst)
artefacts.seal(dst); assert (dst/'MANIFEST.json').read_bytes()==(src/'MANIFEST.json').read_bytes(); print('same manifest')
(dst/'project.json').write_bytes(artefacts.to_json(load_project('truck').model_dump(by_alias=True)).encode())
artefacts.seal(dst)
s=identification.load(dst); print(s.project.design.A_t,s.project.design.synthesised_for)
