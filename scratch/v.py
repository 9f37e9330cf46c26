from base import *
from lpvguard.control.violations import Search, Loop
from lpvguard.engine.synthesis.varying import OverSpeed
sch,*_=K(100.0,1e-6)
s=with_settings(STORED,A_t=56.0,A_u=4.9e-7)
un=Scaling(np.zeros((2,1)))
loop=Loop(OverSpeed(ms.scaled_families(s,sch,un)['performance']),2,sch.Ts)
search=Search(loop,3000,21)
last=None
for r in (8.0,4.0,2.0,1.0):
    t=time.process_time(); f=search.at(r,1.0,last); last=f if f.gain>1 else last
    print(r,f.gain,f.corners,f'cpu {time.process_time()-t:.0f}',flush=True)
