import sys
exec(open('pr.py').read().split("fine=refined")[0].replace('import patch',''))
lc.MOST_CELLS=3000
n=[0]; o=lc._cell_slack; t0=time.process_time()
def cs(f,stg,one_,two,rate):
    r=o(f,stg,one_,two,rate); n[0]+=1
    if two.v-one_.v<0.006: print(n[0],one_.v,two.v-one_.v,r,flush=True)
    return r
lc._cell_slack=cs
print(lc.__file__,'found at',rate,'knots',len(kn),kn,'gain',gain,point.excess)
for r in [float(x) for x in sys.argv[2].split(',')]:
    t=time.process_time(); n[0]=0; p=lc.prove(one,st,r); print('prove',r,p,'tests',n[0],'cpu',time.process_time()-t,flush=True)
