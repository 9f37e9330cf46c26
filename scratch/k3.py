"""_at_level from nothing, told step by step; the P of every rate is kept."""
from base import *
from lpvguard.engine.synthesis import knot_search as ks
A_t,A_u,level,tag=float(sys.argv[1]),float(sys.argv[2]),float(sys.argv[3]),sys.argv[4]
sch,sc,worst,full=K(100.0,1e-6)
s=with_settings(STORED,A_t=A_t,A_u=A_u)
d=cached(f'D_{A_t}_{A_u}_{level}',lambda: ms.tuning(sch,partial(frozen_plant,s),sc)(level))
fam=ms.scaled_families(s,sch,d)['performance']
t0=time.process_time(); w0=time.time(); last={}
say=lambda *x: print(*x,f'cpu {time.process_time()-t0:.0f}',time.strftime('%H:%M:%S'),flush=True)
nsold=ks.newton_step
def ns(b,P,y,directions,slope,price):
    r=nsold(b,P,y,directions,slope,price)
    say('  ',P.shape[0],len(b.M),'y',np.round(r[1],4),f'dec {r[2]:.3g} w {slope[:1]/max(1,len(b.M)*b.constant.shape[-1])} cost {price@np.concatenate([Q[b.upper] for Q in r[0]]):.3g}'); return r
ks.newton_step=ns
fo=ll.found_at
def fa(grid,point,rate,unit):
    r=fo(grid,point,rate,unit)
    if r is not None: pickle.dump((rate,grid.basis,grid.knots,r,grid.speeds),open(f'{tag}_state.pkl','wb'))
    return r
ll.found_at=fa
po=ll.prove
def pr(*a):
    t=time.process_time(); p=po(*a); say('proof',p,time.process_time()-t); return p
ll.prove=pr
f=ll._at_level(fam,(2,2),1.0,level,say)
say(f and (f.proof,f.gain,f.rate,f.level))
pickle.dump((d,f),open(f'{tag}_found.pkl','wb'))
