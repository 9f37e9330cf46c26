import pickle,time,numpy as np
from dataclasses import replace
from pathlib import Path
from lpvguard.identify import run as identification
from lpvguard.control import design as stage, moving_speed as ms
s=identification.load(Path('/tmp/truck/found56'))
r=pickle.load(open('/tmp/truck/s/design56.pkl','rb'))
d,f=pickle.load(open('/tmp/truck/s/q_56.0_4.9e-07.pkl','rb'))
r=replace(r,moving={**r.moving,'performance':ms.Moving(f,d)})
stage.save(r,s,Path('/tmp/truck/design56'))
