"""F at random v, v+ for the stored P, by itself: no code of prove but Storage.at."""
exec(open('pr.py').read().split("fine=refined")[0].replace('import patch',''))
t=time.process_time(); rng=np.random.default_rng(5); n=len(basis); worst=np.inf; scale=np.trace(point.P.mean(axis=0))/n
B=np.linalg.inv(basis)
for i in range(500):
    v=rng.uniform(8,22) if i%3 else np.clip(kn[rng.integers(len(kn))]+rng.uniform(-.012,.012),8,22)
    G=one.loop(v); M=B@np.hstack([G.A@basis,G.B]); N=np.hstack([G.C@basis,G.D])
    for u in (v-0.01,v+0.01,v+rng.uniform(-.01,.01)):
        if not 8<=u<=22: continue
        F=-M.T@st.at(u)@M-N.T@N; F[:n,:n]+=st.at(v); F[n:,n:]+=np.eye(F.shape[0]-n)
        e=np.linalg.eigvalsh((F+F.T)/2)[0]
        if e<worst: worst=e; print(i,v,u,e/scale,flush=True)
print('least over',i+1,'speeds',worst/scale,'cpu',time.process_time()-t)
