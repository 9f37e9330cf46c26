import os,sys,pickle,time
os.environ.setdefault('OPENBLAS_NUM_THREADS','1')
from dataclasses import replace
from functools import partial
import numpy as np
from lpvguard.identify import run as identification
from lpvguard.control import design as stage, moving_speed as ms
from lpvguard.control.plants import design_settings, fig1_weights, frozen_plant, plant_at
from lpvguard.base.sampling import evenly
from lpvguard.engine.synthesis import least_level as ll, lpv_certificate as lc
from lpvguard.engine.synthesis.scheduling import common_scaling, closed_scaled
from lpvguard.engine.synthesis.dk import Scaling, certify, dk_synthesis
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.vehicle.nominal import NominalModel
STORED = identification.load(__import__('pathlib').Path(os.environ.get('IDENT','/tmp/truck/identify')))
def with_settings(stored, **c):
    return replace(stored, project=stored.project.model_copy(update={"design": stored.project.design.model_copy(update=c)}))
def cached(name, make):
    p=f'/tmp/truck/s/{name}.pkl'
    if os.path.exists(p): return pickle.load(open(p,'rb'))
    t=time.process_time(); x=make(); print(name, 'cpu', time.process_time()-t, flush=True)
    pickle.dump(x, open(p,'wb')); return x
def K(A_t, A_u, **more):
    name='K_'+'_'.join(f'{k}{v}' for k,v in {'A_t':A_t,'A_u':A_u,**more}.items())
    def make():
        s=with_settings(STORED,A_t=A_t,A_u=A_u,**more)
        d=stage._designed(s,s.project.design,None,lambda _:None)
        return d.schedule,d.scaling,d.worst,d.full_order
    return cached(name,make)
def optimum(A_t,A_u):
    """common-scaling optimum for four nodes"""
    def make():
        s=with_settings(STORED,A_t=A_t,A_u=A_u)
        set_=s.project.design
        model, w = NominalModel(s.project), fig1_weights(s,set_)
        speeds=np.linspace(*model.speed_range,set_.nodes)
        some=evenly(len(speeds),stage.SCALING_SPEEDS)
        plants=[plant_at(s,model,w,speeds[k],True,set_.structure) for k in some]
        start=Scaling(SC100)
        return common_scaling(plants,start)
    return cached(f'opt_{A_t:g}_{A_u:g}',make)
SC100=K(100.0,1e-6)[1].log_parameters
