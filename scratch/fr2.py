import pickle,time,numpy as np
from functools import partial
from dataclasses import replace
from pathlib import Path
from lpvguard.identify import run as identification
from lpvguard.control import design as stage, moving_speed as ms
from lpvguard.control.plants import plant_at, fig1_weights
from lpvguard.control.beside import beside
from lpvguard.vehicle.nominal import NominalModel
s=identification.load(Path('/tmp/truck/found56')); settings=s.project.design
found,sc,worst,full=pickle.load(open('/tmp/truck/s/K_A_t100.0_A_u1e-06.pkl','rb'))
t=time.process_time()
model=NominalModel(s.project); w=fig1_weights(s,settings)
stated_at=lambda v: plant_at(s,model,w,v,False,settings.structure)
check=np.linspace(found.speeds[0],found.speeds[-1],2*len(found.speeds)-1)
loops={float(v):stated_at(float(v)) for v in check}
scaling=ms.tuning(found,stated_at,sc)(1.0)
r=stage.Design(found,scaling,stage._certificates(found,loops,scaling),full,stage._off_grid(found,scaling,stated_at,s.project.seed))
print('worst',r.worst,'cpu',time.process_time()-t,flush=True)
stage._require_reach(s,found)
fl=ms.find_level; ms.find_level=lambda *_:None
mv=ms.moving_certificates(s,found,scaling,lambda p:print(p,flush=True))
print('stability',mv['stability'] and (mv['stability'].lpv.rate,mv['stability'].lpv.proof),'cpu',time.process_time()-t,flush=True)
r=replace(r,moving=mv,beside=beside(s,found,scaling,lambda p:None))
pickle.dump(r,open('/tmp/truck/s/design56.pkl','wb')); print('done cpu',time.process_time()-t,flush=True)
dq=pickle.load(open('/tmp/truck/s/Dq_56.0_4.9e-07.pkl','rb'))
d2=ms.tuning(found,stated_at,scaling)(1.0)
print(np.array_equal(dq.log_parameters,scaling.log_parameters),dq.log_parameters,scaling.log_parameters,d2.log_parameters)
